"""What ``biobot-gateway status`` shows: its picture from known statuses, and the program on a real terminal of 80 columns."""

import asyncio
import fcntl
import io
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from firmware_protocol.contract.announcements import GatewayEvent
from firmware_protocol.contract.records import GatewayStatus, RadioReport
from firmware_protocol.units import BootId, Nanoseconds
from gateway.site_view import Presence, SiteView
from gateway.status_screen import draw
from tests.gateway.harness import a_config, running

ROOT = Path(__file__).parents[2]
S = 1_000_000_000
BY_ID = "serial:/dev/serial/by-id/usb-Silicon_Labs_Sonoff_Zigbee_3.0_USB_Dongle_Plus_0001-if00-port0"


def a_status(at_s: int, *, name: str = "base1", boot: int = 1, head: int = 0, n_messages: int = 0, **more: object) -> GatewayStatus:
    fields: dict[str, object] = {
        "radio_reports": {
            "tcp:10.0.0.2:6638": RadioReport(state="up", since_wall_ns=Nanoseconds(0), n_messages=n_messages, n_bytes=60 * n_messages),
            BY_ID: RadioReport(state="down", since_wall_ns=Nanoseconds(S), reason="there is no such device", attempts=3, n_faults=17),
        },
        "started_wall_ns": Nanoseconds(S),
        "n_biobots": 120,
        "journal_bytes": 1_234_000_000,
        "disk_free_bytes": 64_000_000_000,
    }
    return GatewayStatus(
        gateway=name,
        journal="feed",
        boot=BootId(boot),
        head_offset=head,
        wall_ns=Nanoseconds(at_s * S),
        radios={"tcp:10.0.0.2:6638": "up", BY_ID: "down"},
        counters={},
        **(fields | more),  # type: ignore[arg-type]  # by name
    )


def picture(view: SiteView, *, now_s: float = 10.0, is_connected: bool = True, why_alone: str | None = None, width: int = 80) -> str:
    out = io.StringIO()
    connect = ["tcp/127.0.0.1:7447"]
    drawn = draw(view, site="local", connect=connect, is_connected=is_connected, why_alone=why_alone, waited_s=7.0, now_s=now_s)
    Console(file=out, width=width, force_terminal=False).print(drawn)
    text = out.getvalue()
    assert max(map(len, text.splitlines())) <= width
    return text


def a_view(*statuses: GatewayStatus, now_s: float = 10.0) -> SiteView:
    view = SiteView()
    for one in statuses:
        view.take(one, now_s=now_s)
    return view


def test_rates_state_reasons_and_faults_are_shown_in_80_columns() -> None:
    marks = {"desk": 30_200, "laptop": 29_000}
    statuses = [
        a_status(at, head=100 * at, n_messages=50 * at, faults=("the disk is full",), missing=("no router",), watermarks=marks)
        for at in (300, 302)
    ]
    text = picture(a_view(*statuses))

    assert "base1 up 5 min" in text
    assert "journal 30,200 (+100/s), 1.2 GB, 64.0 GB free; biobots 120" in text
    rows = [line.strip("│ ").split() for line in text.splitlines()]
    assert ["tcp:10.0.0.2:6638", "up", "5", "min", "50.0", "3,000", "0"] in rows
    assert next(one[1:7] for one in rows if one and one[0].startswith("serial:…")) == ["down", "5", "min", "0.0", "0", "17"]
    assert "Dongle_Plus_0001-if00-port0" not in text
    assert "0001-if00-port0" in text, "the end of a name tells dongles apart"
    assert "there is no such device (3 attempts)" in text.replace("\n", " ")
    assert "mappers: desk has all, laptop lacks 1,200 records" in text
    assert "! the disk is full" in text
    assert "waits: no router" in text


def test_a_gateway_that_started_anew_has_no_rate_from_before() -> None:
    view = a_view(a_status(300, head=900), a_status(301, head=10, boot=2), a_status(302, head=12, boot=2))
    assert "(+2/s)" in picture(view)
    assert "(+0/s)" in picture(a_view(a_status(302, boot=3)))


def test_it_is_said_when_a_gateway_is_gone_silent_or_not_there_at_all() -> None:
    assert "nobody answers there, for 7 s" in picture(SiteView(), is_connected=False).replace("\n", " ")
    assert "no gateway of this site is heard, for 7 s" in picture(SiteView()).replace("\n", " ")
    view = a_view(a_status(300), a_status(300, name="base2"))
    assert "base1 silent for 6 s" in picture(view, now_s=16.0)
    view.take(Presence(gateway="base2", is_alive=False), now_s=20.0)
    text = picture(view, now_s=25.0, is_connected=False)
    assert "base2 gone for 5 s" in text
    assert "the connection is cut:" in text
    text = picture(view, now_s=25.0, is_connected=False, why_alone="tcp/a:1: nobody listens there").replace("\n", " ")
    assert "the connection is cut (tcp/a:1: nobody listens there)" in text
    view.take(a_status(330, name="base2", boot=2), now_s=30.0)
    assert "gone" not in picture(view, now_s=30.0)


def test_an_older_gateway_that_tells_less_is_shown_too() -> None:
    full = a_status(300, head=5)
    known = ("gateway", "journal", "boot", "head_offset", "wall_ns", "radios", "counters")
    text = picture(a_view(GatewayStatus(**{name: getattr(full, name) for name in known})))
    assert "journal 5 (+0/s); biobots 0" in text
    assert re.search(r"tcp:10.0.0.2:6638 +up +0 s", text)


@given(st.text(max_size=60), st.text(max_size=60), st.dictionaries(st.text(max_size=9), st.text(max_size=9), max_size=3))
def test_nothing_from_the_bus_moves_the_cursor_or_is_taken_for_markup(name: str, reason: str, facts: dict[str, str]) -> None:
    report = RadioReport(state=reason[:9], since_wall_ns=Nanoseconds(0), reason=reason)
    view = a_view(a_status(300, name=name, radio_reports={name: report}, faults=(reason, "[bold]x[/]")))
    view.take(GatewayEvent(gateway=name, wall_ns=Nanoseconds(0), level=reason, kind=name, facts=facts), now_s=10.0)
    out = io.StringIO()
    Console(file=out, width=80).print(draw(view, site="s", connect=[reason], is_connected=True, waited_s=0.0, now_s=10.0))
    assert "\x1b" not in out.getvalue()
    assert "[bold]x[/]" in out.getvalue()


class Terminal:
    """A pseudo-terminal of 80 columns with ``status`` on it; ``text`` is all that it has drawn."""

    def __init__(self, *arguments: str) -> None:
        self.text = ""
        self.master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        environment = {name: value for name, value in os.environ.items() if name not in {"COLUMNS", "LINES", "NO_COLOR"}}
        environment |= {"PYTHONPATH": str(ROOT), "TERM": "xterm-256color", "LANG": "C.UTF-8"}
        command = [sys.executable, "-m", "gateway", "status", *arguments]
        self.process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, env=environment)
        os.close(slave)
        os.set_blocking(self.master, False)

    async def until(self, words: str) -> None:
        """Wait until these words have been drawn since the last call."""
        loop, came = asyncio.get_running_loop(), asyncio.Event()
        loop.add_reader(self.master, came.set)
        try:
            async with asyncio.timeout(60):
                while words not in self.text:
                    await came.wait()
                    came.clear()
                    try:
                        self.text += os.read(self.master, 65_536).decode(errors="replace")
                    except BlockingIOError:
                        continue
        except TimeoutError:
            pytest.fail(f"{words!r} was not drawn: {self.text[-2000:]}")
        finally:
            loop.remove_reader(self.master)
        self.text = self.text.rpartition(words)[2]


@pytest.mark.e2e
def test_on_a_terminal_gateways_come_and_go_live_and_the_terminal_is_left_as_it_was(tmp_path: Path) -> None:
    async def live() -> None:
        config = a_config(tmp_path, "serial:/dev/not-there")
        terminal = Terminal("--site", "test", "--connect", config.listen[0])
        await terminal.until("not connected, for ")
        await terminal.until("nobody listens there")
        async with running(config):
            await terminal.until("base1")
            await terminal.until("serial:/dev/not-there")
            await terminal.until("no radio is up")
        await terminal.until("gone")
        terminal.process.send_signal(signal.SIGTERM)
        await terminal.until("\x1b[?1049l")
        assert await asyncio.to_thread(terminal.process.wait, 60) == 0
        os.close(terminal.master)

    asyncio.run(live())
