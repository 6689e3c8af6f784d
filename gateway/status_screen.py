"""Draws the gateways of a site for a terminal; 80 columns are enough. What came over the bus is shown as text, never obeyed."""

import time
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from firmware_protocol.contract.announcements import GatewayEvent
from firmware_protocol.contract.records import GatewayStatus, RadioReport
from firmware_protocol.units import NS_PER_S
from gateway.site_view import SILENT_S, GatewayView, SiteView

_STATE_STYLES = {"up": "green", "connecting": "yellow", "down": "bold red"}
_LEVEL_STYLES = {"warning": "yellow", "error": "bold red"}
_EVENTS_SHOWN = 8
_NAME_WIDTH = 34
_PREFIXES = "kMGTP"


def draw(
    view: SiteView, *, site: str, connect: Sequence[str], is_connected: bool, why_alone: str | None = None, waited_s: float, now_s: float
) -> RenderableType:
    """Return the whole picture.

    Parameters
    ----------
    why_alone
        Why nobody is connected, where it is known.
    waited_s
        How long this view has been listening [s].
    now_s
        Now, on the clock of ``SiteView.take``.
    """
    gateways = view.gateways()
    line = Text(f"site {_plain(site)} on {', '.join(map(_plain, connect))}, {time.strftime('%H:%M:%S')}", style="dim")
    parts: list[RenderableType] = [line]
    if not gateways:
        parts.append(Text(_why_no_gateway(is_connected=is_connected, why_alone=why_alone, waited_s=waited_s), style="yellow"))
    parts += [_draw_gateway(one, now_s=now_s) for one in gateways]
    if gateways and not is_connected:
        reason = f" ({_plain(why_alone)})" if why_alone else ""
        parts.append(Text(f"the connection is cut{reason}: what is shown is what was last heard", style="bold red"))
    if view.events:
        parts.append(Text("events", style="dim"))
        parts += [_draw_event(event) for event in list(view.events)[-_EVENTS_SHOWN:]]
    return Group(*parts)


def _why_no_gateway(*, is_connected: bool, why_alone: str | None, waited_s: float) -> str:
    if is_connected:
        question = "is it running, is --site its own, and is it on the router's roster?"
        return f"connected, but no gateway of this site is heard, for {_span(waited_s)}: {question}"
    if why_alone:
        return f"not connected, for {_span(waited_s)}: {_plain(why_alone)}"
    return f"nobody answers there, for {_span(waited_s)}: is the gateway running, and is --connect its own?"


def _draw_gateway(view: GatewayView, *, now_s: float) -> RenderableType:
    status = view.status
    if status is None:
        state = f"gone for {_span(now_s - view.gone_s)}" if view.gone_s is not None else "is there, and has not told its status yet"
        return Text(f"{_plain(view.name)} {state}", style="yellow")
    title = Text(_plain(view.name), style="bold")
    silent_s = 0.0 if view.heard_s is None else now_s - view.heard_s
    if view.gone_s is not None:
        title.append(f" gone for {_span(now_s - view.gone_s)}", style="bold red")
    elif silent_s > SILENT_S:
        title.append(f" silent for {_span(silent_s)}", style="bold red")
    elif status.started_wall_ns:
        title.append(f" up {_span((status.wall_ns - status.started_wall_ns) / NS_PER_S)}")
    parts: list[RenderableType] = [_draw_journal(view, status), _draw_radios(view, status)]
    parts += _mappers(status)
    parts += [Text(f"! {_plain(fault)}", style="bold red") for fault in status.faults]
    parts += [Text(f"waits: {_plain(one)}", style="yellow", no_wrap=True, overflow="ellipsis") for one in status.missing]
    return Panel(Group(*parts), title=title, title_align="left", border_style="dim" if view.gone_s is None else "red")


def _draw_journal(view: GatewayView, status: GatewayStatus) -> Text:
    line = Text(f"journal {status.head_offset:,} (+{view.records_per_s():,.0f}/s)")
    if status.journal_bytes is not None:
        line.append(f", {_bytes(status.journal_bytes)}")
    if status.disk_free_bytes is not None:
        line.append(f", {_bytes(status.disk_free_bytes)} free")
    line.append(f"; biobots {status.n_biobots:,}")
    return line


def _mappers(status: GatewayStatus) -> list[Text]:
    """Say how far each mapper has this gateway's records; what none has told is not known here."""
    if not status.watermarks:
        return []
    lags = {name: max(0, status.head_offset - offset) for name, offset in sorted(status.watermarks.items())}
    told = [f"{_plain(name)} {f'lacks {lag:,} records' if lag else 'has all'}" for name, lag in lags.items()]
    return [Text(f"mappers: {', '.join(told)}")]


def _draw_radios(view: GatewayView, status: GatewayStatus) -> RenderableType:
    table = Table(box=None, padding=(0, 1, 0, 0), expand=True)
    table.add_column("radio", ratio=1, no_wrap=True)
    table.add_column("state")
    for heading in ("since", "msgs/s", "bytes/s", "faults"):
        table.add_column(heading, justify="right", no_wrap=True)
    reasons = []
    for name, report in view.reports().items():
        since = _span((status.wall_ns - report.since_wall_ns) / NS_PER_S)
        rates = f"{view.messages_per_s(name):,.1f}", f"{view.bytes_per_s(name):,.0f}"
        state = Text(_plain(report.state), style=_STATE_STYLES.get(report.state, ""))
        table.add_row(Text(_short(name)), state, since, *rates, f"{report.n_faults:,}")
        reasons += _reason(name, report)
    return Group(table, *reasons)


def _reason(name: str, report: RadioReport) -> list[Text]:
    if not report.reason:
        return []
    attempts = f" ({report.attempts:,} attempts)" if report.attempts else ""
    return [Text(f"{_short(name)}: {_plain(report.reason)}{attempts}", style="yellow")]


def _draw_event(event: GatewayEvent) -> Text:
    moment = time.strftime("%H:%M:%S", time.localtime(event.wall_ns / NS_PER_S))
    facts = " ".join(f"{_plain(key)}={_plain(value)}" for key, value in event.facts.items() if value)
    text = f"{moment} {_plain(event.gateway)} {_plain(event.kind)} {facts}"
    return Text(text, style=_LEVEL_STYLES.get(event.level, "dim"), no_wrap=True, overflow="ellipsis")


def _plain(text: str) -> str:
    """Return a text without what could move a terminal's cursor or colour it."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _short(name: str) -> str:
    """Return a radio's name so short that it fits; its end tells dongles of one kind apart."""
    plain = _plain(name)
    kind, colon, rest = plain.partition(":")
    room = _NAME_WIDTH - len(kind) - 2
    return plain if len(plain) <= _NAME_WIDTH or room < 8 else f"{kind}{colon}…{rest[-room:]}"


def _span(seconds: float) -> str:
    whole = max(0, int(seconds))
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min"
    return f"{whole // 3600} h" if whole < 172_800 else f"{whole // 86_400} d"


def _bytes(n: int) -> str:
    value, unit = float(n), ""
    for prefix in _PREFIXES:
        if value < 1000:
            break
        value, unit = value / 1000, prefix
    return f"{value:.0f} B" if not unit else f"{value:.1f} {unit}B"
