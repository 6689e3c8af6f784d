"""Laws of who is there: tokens, beats, silence."""

import asyncio

from gateway.commanders import Commanders
from gateway.health import Health
from tests.gateway.control_fakes import NoteBook

_S = 1_000_000_000


def some(silence_s: float = 1.0) -> tuple[Commanders, list[tuple[str, str]], NoteBook]:
    notes, gone = NoteBook(), list[tuple[str, str]]()
    commanders = Commanders(silence_s=silence_s, health=Health(), notes=notes)
    commanders.listen(lambda name, reason: gone.append((name, reason)))
    return commanders, gone, notes


def test_a_token_alone_is_enough_for_a_commander_that_never_beat() -> None:
    commanders, gone, _ = some()
    commanders.came("ann")
    commanders.judge([("ann", 0)], now_ns=3600 * _S)
    assert commanders.is_there("ann")
    commanders.went("ann")
    assert not commanders.is_there("ann")
    assert [name for name, _ in gone] == ["ann"]


def test_a_commander_that_beat_and_falls_silent_is_gone_while_it_moves_anybody() -> None:
    commanders, gone, notes = some()
    commanders.came("ann")
    commanders.beat("ann", number=1, at_ns=10)
    commanders.judge([], now_ns=100 * _S)
    assert commanders.is_there("ann"), "who moves nobody need not beat"
    assert commanders.next_judgement_ns([("ann", 99 * _S)]) == 100 * _S
    commanders.judge([("ann", 99 * _S)], now_ns=100 * _S - 1)
    assert commanders.is_there("ann"), "silence counts from the motion on"
    commanders.judge([("ann", 99 * _S)], now_ns=100 * _S)
    assert not commanders.is_there("ann")
    assert len(gone) == 1
    commanders.went("ann")
    assert len(gone) == 1, "gone once"
    assert [facts["event"] for kind, facts in notes.entries if kind == "commander"] == ["came", "silent", "went"]


def test_a_beat_that_is_not_newer_is_no_sign_of_life() -> None:
    commanders, gone, _ = some()
    commanders.came("ann")
    commanders.beat("ann", number=5, at_ns=0)
    commanders.beat("ann", number=5, at_ns=_S)
    commanders.beat("ann", number=4, at_ns=_S)
    commanders.judge([("ann", 0)], now_ns=_S)
    assert not commanders.is_there("ann")
    commanders.beat("ann", number=6, at_ns=2 * _S)
    assert commanders.is_there("ann")
    assert len(gone) == 1


def test_a_beat_of_nobody_makes_nobody_a_commander() -> None:
    commanders, _, _ = some()
    commanders.beat("ann", number=1, at_ns=0)
    assert not commanders.is_there("ann")


def test_a_token_that_is_late_is_waited_for() -> None:
    async def story() -> None:
        commanders, _, _ = some()
        waiting = asyncio.ensure_future(commanders.wait_for("ann", timeout_s=10.0))
        await asyncio.sleep(0)
        commanders.came("bob")
        commanders.came("ann")
        assert await waiting
        assert not await commanders.wait_for("eve", timeout_s=0.01)

    asyncio.run(story())
