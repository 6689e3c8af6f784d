"""The pulse train that a command gives: its own values over the configuration's, within the limits of that and of the backpack. Pure.

The table in the configuration is the gateway's own limit; what a backpack announces makes it stricter, never looser. A refusal names
the value, whose limit it breaks, and what would do.
"""

from dataclasses import dataclass, field

from firmware_protocol.contract.commands import PulseRequest, Refusal, WaveformName
from firmware_protocol.messages import OWN_CHANNEL, Limits, Waveform
from gateway.config import StimulationTable
from gateway.stimulation.verdict import Refused

WAVEFORMS = {
    WaveformName.SYMMETRIC: Waveform.SYMMETRIC_BIPHASIC,
    WaveformName.ASYMMETRIC: Waveform.ASYMMETRIC_BIPHASIC,
    WaveformName.MONOPHASIC: Waveform.MONOPHASIC,
}

_UNITS = {"frequency_hz": "Hz", "pulse_width_us": "us", "amplitude_mv": "mV", "duration_ms": "ms"}
_LAST_CHANNEL = 7  # WIRE_FORMAT.md §5.8: a bit each of an octet
_US_PER_S = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulse:
    """A pulse train; ``asked`` names what the command itself said of it, the rest is the configuration's."""

    frequency_hz: int
    pulse_width_us: int
    amplitude_mv: int
    duration_ms: int
    channel: int
    waveform: WaveformName
    asked: frozenset[str] = field(default=frozenset(), compare=False)


def pulse_of(request: PulseRequest | None, table: StimulationTable, *, is_bare: bool = False) -> Pulse:
    """Return the train that a command means; one of a bare command has a train only where it asks for its duration."""
    wanted = {} if request is None else {name: getattr(request, name) for name in PulseRequest.__struct_fields__}
    asked = {name: value for name, value in wanted.items() if value is not None}
    values = {name: asked.get(name, getattr(table, name)) for name in PulseRequest.__struct_fields__}
    if is_bare and "duration_ms" not in asked:
        values["duration_ms"] = 0
    return Pulse(**values, asked=frozenset(asked))


def pulse_refusal(pulse: Pulse, *, table: StimulationTable, limits: Limits | None) -> Refused | None:
    """Return why a train is beyond a limit of the table, or of a backpack with these limits, or None.

    Without a duration there is no train, and nothing of it is beyond a limit.
    """
    if pulse.duration_ms == 0:
        return None
    reason = _beyond_table(pulse, table) or _beyond_period(pulse) or (None if limits is None else _beyond_backpack(pulse, limits))
    return None if reason is None else Refused(refusal=Refusal.PULSE, reason=reason)


def _beyond_table(pulse: Pulse, table: StimulationTable) -> str | None:
    for name, key in (
        ("frequency_hz", "max_frequency_hz"),
        ("pulse_width_us", "max_pulse_width_us"),
        ("amplitude_mv", "max_amplitude_mv"),
        ("duration_ms", "max_duration_ms"),
    ):
        limit = getattr(table, key)
        if getattr(pulse, name) > limit:
            return f"{_said(pulse, name)}, but stimulation.{key} is {limit} {_UNITS[name]}; {_ask(pulse, name, f'{limit} or less')}"
    if pulse.frequency_hz < table.min_frequency_hz:
        limit = f"stimulation.min_frequency_hz is {table.min_frequency_hz} Hz"
        return f"{_said(pulse, 'frequency_hz')}, but {limit}; {_ask(pulse, 'frequency_hz', f'{table.min_frequency_hz} or more')}"
    if "waveform" in pulse.asked and pulse.waveform is WaveformName.MONOPHASIC and not table.allows_unbalanced:
        return "it asks for waveform = monophasic, but stimulation.allows_unbalanced is false; ask for symmetric or asymmetric"
    if _LAST_CHANNEL < pulse.channel < OWN_CHANNEL:
        limit = f"a backpack has channels 0 to {_LAST_CHANNEL}, and {OWN_CHANNEL} leaves it to the backpack"
        return f"{_said(pulse, 'channel')}, but {limit}; {_ask(pulse, 'channel', 'one of these')}"
    return None


def _beyond_period(pulse: Pulse) -> str | None:
    """Return why the phases of a pulse do not fit into its period (WIRE_FORMAT.md §6.5), or None."""
    n_phases = 1 if pulse.waveform is WaveformName.MONOPHASIC else 2
    longest_us = _US_PER_S // (n_phases * pulse.frequency_hz)
    if pulse.pulse_width_us > longest_us:
        return (
            f"{_said(pulse, 'pulse_width_us')}, but at {pulse.frequency_hz} Hz {n_phases} phases of {longest_us} us fit into a period; "
            f"{_ask(pulse, 'pulse_width_us', f'{longest_us} or less')}"
        )
    return None


def _beyond_backpack(pulse: Pulse, limits: Limits) -> str | None:
    for name, limit in (
        ("frequency_hz", limits.max_frequency_hz),
        ("pulse_width_us", limits.max_pulse_width_us),
        ("amplitude_mv", limits.max_amplitude_mv),
        ("duration_ms", limits.max_duration_ms),
    ):
        if getattr(pulse, name) > limit:
            return f"{_said(pulse, name)}, but this backpack takes at most {limit} {_UNITS[name]}; {_ask(pulse, name, f'{limit} or less')}"
    if pulse.channel == OWN_CHANNEL:
        if not limits.channels:
            return f"{_said(pulse, 'channel')}, which leaves it to the backpack, but this backpack has no channels; use another backpack"
    elif not limits.channels >> pulse.channel & 1:
        there = _channels(limits.channels)
        return f"{_said(pulse, 'channel')}, but this backpack has {there}; {_ask(pulse, 'channel', 'one that it has')}"
    if not limits.waveforms >> WAVEFORMS[pulse.waveform] & 1:
        names = [name.value for name, waveform in WAVEFORMS.items() if limits.waveforms >> waveform & 1]
        known = " and ".join(names) or "none that is known here"
        return f"{_said(pulse, 'waveform')}, but this backpack makes {known}; {_ask(pulse, 'waveform', 'one that it makes')}"
    return None


def _said(pulse: Pulse, name: str) -> str:
    value = getattr(pulse, name)
    text = f"{value.value if isinstance(value, WaveformName) else value} {_UNITS.get(name, '')}".rstrip()
    return f"it asks for {name} = {text}" if name in pulse.asked else f"the configuration says stimulation.{name} = {text}"


def _ask(pulse: Pulse, name: str, what: str) -> str:
    return f"ask for {what}" if name in pulse.asked else f"set stimulation.{name} to {what}, or ask for it in the command"


def _channels(bits: int) -> str:
    there = [str(channel) for channel in range(8) if bits >> channel & 1]
    return f"channels {', '.join(there)}" if there else "no channels"
