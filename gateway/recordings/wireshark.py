"""Makes the Wireshark dissector: tables in Lua from ``layouts.py``, in front of the engine in ``wireshark.lua`` that reads them."""

from enum import IntEnum
from importlib.metadata import version
from importlib.resources import files

from firmware_protocol.envelope import RadioStatus
from firmware_protocol.layouts import DOWNLINK_HEADER, DOWNLINK_LAYOUTS, ENVELOPE_LAYOUTS, UPLINK_HEADER, UPLINK_LAYOUTS, Field, Layout
from firmware_protocol.messages import (
    MAX_RADIO_PAYLOAD,
    Action,
    ConfigurationResult,
    Level,
    StimulationResult,
    Waveform,
    WireCause,
    WireMode,
)
from gateway.recordings.capture import PREFIX
from gateway.recordings.native_line import KINDS

_NAMES: dict[str, type[IntEnum]] = {"mode": WireMode, "cause": WireCause, "action": Action, "level": Level, "waveform": Waveform}
"""Fields whose values have names, in whatever message."""

_MORE_NAMES: dict[tuple[str, str], type[IntEnum]] = {
    ("StimulateReply", "result"): StimulationResult,
    ("ConfigurationReport", "result"): ConfigurationResult,
    ("CoordinatorConfigured", "result"): ConfigurationResult,
    ("RadioConfirm", "status"): RadioStatus,
}
"""Fields whose values have names in one message."""

_LINK_HEADER = (Field(name="kind", code="B"), Field(name="session", code="H"), Field(name="link_sequence", code="B"))  # §3.1

# The three envelopes that are not in the table, because they carry a radio payload to the end or belong to one (§4.3 to §4.5).
_CARRIERS = (
    Layout(name="RadioSend", kind=0x20, section="4.3", fields=(Field(name="handle", code="H"), Field(name="destination", code="H"))),
    Layout(name="RadioConfirm", kind=0x21, section="4.4", fields=(Field(name="handle", code="H"), Field(name="status", code="B"))),
    Layout(
        name="RadioReceived",
        kind=0x22,
        section="4.5",
        fields=(Field(name="source", code="H"), Field(name="rssi_dbm", code="b", unit="dBm"), Field(name="lqi", code="B")),
    ),
)
DISSECTOR_MARK = "-- Made by biobot-gateway"
"""How every dissector begins, of whatever version."""

_CARRY_PAYLOAD = {"RadioSend", "RadioReceived"}


def make_lua_dissector() -> str:
    """Return the whole Lua file."""
    messages = [_layout(one, is_uplink=True) for one in UPLINK_LAYOUTS] + [_layout(one, is_uplink=False) for one in DOWNLINK_LAYOUTS]
    envelopes = [_layout(one, is_uplink=False) for one in (*ENVELOPE_LAYOUTS, *_CARRIERS)]
    return "\n".join(
        [
            f"{DISSECTOR_MARK} {version('biobot-gateway')}: biobot-gateway pcap --dissector FILE",
            f"local PREFIX = {PREFIX[0]}",
            f"local MAX_RADIO_PAYLOAD = {MAX_RADIO_PAYLOAD}",
            f"local LINK_KINDS = {_names(KINDS)}",
            f"local LINK_HEADER = {_fields('link', _LINK_HEADER)}",
            f"local UPLINK_HEADER = {_fields('header', UPLINK_HEADER.fields)}",
            f"local DOWNLINK_HEADER = {_fields('header', DOWNLINK_HEADER.fields)}",
            "local MESSAGES = {",
            *messages,
            "}",
            "local ENVELOPES = {",
            *envelopes,
            "}",
            "",
            files("gateway.recordings").joinpath("wireshark.lua").read_text(encoding="utf-8"),
        ]
    )


def _layout(layout: Layout, *, is_uplink: bool) -> str:
    facts = [
        f"name = {_quoted(layout.name)}",
        f"key = {_quoted(layout.name.lower())}",
        f"is_uplink = {_boolean(is_uplink)}",
        f"carries_payload = {_boolean(layout.name in _CARRY_PAYLOAD)}",
        f"text = {_boolean(layout.text_limit is not None)}",
        f"fields = {_fields(layout.name, layout.fields)}",
        f"entry = {_fields(layout.name, layout.entry)}",
    ]
    return f"  [{layout.kind}] = {{ {', '.join(facts)} }},"


def _fields(layout: str, fields: tuple[Field, ...]) -> str:
    parts = []
    for one in fields:
        names = _MORE_NAMES.get((layout, one.name)) or _NAMES.get(one.name)
        named = f", names = {_names({value.value: value.name.lower() for value in names})}" if names else ""
        parts.append(f"{{ name = {_quoted(one.name)}, code = {_quoted(one.code)}, unit = {_quoted(one.unit)}{named} }}")
    return f"{{ {', '.join(parts)} }}"


def _names(names: dict[int, str]) -> str:
    return "{ " + ", ".join(f"[{value}] = {_quoted(name)}" for value, name in names.items()) + " }"


def _quoted(text: str) -> str:
    return f'"{text}"'


def _boolean(value: bool) -> str:  # noqa: FBT001  # a value to be written, not a switch
    return "true" if value else "false"
