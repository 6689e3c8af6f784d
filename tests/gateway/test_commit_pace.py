"""Laws of the journal's pace: a lone write waits for nothing, many share a commit, and what somebody waits for goes at once."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from contextlib import closing
from pathlib import Path

import pytest

from firmware_protocol.contract.records import Mode
from gateway.commit_pace import MANY_WRITES, CommitPace
from gateway.health import Health
from gateway.journal import Journal
from gateway.journal_file import JournalWrite
from tests.gateway.makers import a_mode_record


def _in_loop(story: Callable[[CommitPace, asyncio.AbstractEventLoop], Awaitable[None]]) -> None:
    async def run() -> None:
        await story(CommitPace(), asyncio.get_running_loop())

    asyncio.run(run())


async def _is_free(pace: CommitPace, *, is_urgent: bool = False) -> bool:
    """Whether the next group may go without any waiting: the coroutine ends in its first step."""
    waiting = pace.wait(is_urgent=is_urgent)
    try:
        waiting.send(None)
    except StopIteration:
        return True
    waiting.close()
    return False


@pytest.mark.parametrize(("n_writes", "is_free"), [(0, True), (1, True), (MANY_WRITES - 1, True), (MANY_WRITES, False), (1000, False)])
def test_only_after_many_writes_the_next_group_waits(n_writes: int, is_free: bool) -> None:
    async def story(pace: CommitPace, loop: asyncio.AbstractEventLoop) -> None:
        assert await _is_free(pace)
        pace.begin(n_writes, now_s=loop.time() + 1000)
        assert await _is_free(pace) is is_free

    _in_loop(story)


def test_a_pause_is_over_of_itself_and_for_whoever_is_in_a_hurry() -> None:
    async def story(pace: CommitPace, loop: asyncio.AbstractEventLoop) -> None:
        pace.begin(MANY_WRITES, now_s=loop.time())
        async with asyncio.timeout(60):
            await pace.wait(is_urgent=False)
        pace.begin(MANY_WRITES, now_s=loop.time() + 1000)
        assert await _is_free(pace, is_urgent=True)
        waiting = asyncio.ensure_future(pace.wait(is_urgent=False))
        await asyncio.sleep(0)
        assert not waiting.done()
        pace.hurry()
        await waiting
        assert not await _is_free(pace), "one hurry is for one group"

    _in_loop(story)


def test_a_write_that_is_waited_for_takes_those_before_it_along_in_one_commit(tmp_path: Path) -> None:
    """The pace is set for ever, so nothing else than the hurry can end the pause."""

    async def story() -> None:
        health = Health()
        with closing(Journal.open(tmp_path / "j", health=health)) as journal:
            running = asyncio.ensure_future(journal.run())
            await journal.append(_write(0))
            journal._pace.begin(MANY_WRITES, now_s=asyncio.get_running_loop().time() + 1000)
            joined = [journal.join(_write(number)) for number in range(1, 4)]
            for _ in range(3):
                await asyncio.sleep(0)
            assert not any(one.done() for one in joined)
            await journal.append(_write(4))
            assert all(one.done() for one in joined)
            assert health.counters()["journal.commits"] == 2
            running.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await running

    asyncio.run(story())


def _write(number: int) -> JournalWrite:
    return JournalWrite(records=(a_mode_record(sequence=number, node=1, mode=Mode.S),))
