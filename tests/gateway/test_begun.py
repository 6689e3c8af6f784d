"""Laws of coroutines that are begun before their task has its turn."""

import asyncio

import pytest

from gateway.begun import begin


def test_all_up_to_the_first_wait_is_done_at_once_and_the_rest_when_it_is_awaited() -> None:
    async def story() -> None:
        done: list[str] = []
        ready = asyncio.get_running_loop().create_future()

        async def speak() -> None:
            done.append("at once")
            done.append(await ready)
            async with asyncio.timeout(60):
                await asyncio.sleep(0)
                done.append("later")

        rest = begin(speak())
        assert done == ["at once"]
        assert rest is not None
        ready.set_result("ready")
        await asyncio.create_task(rest)
        assert done == ["at once", "ready", "later"]

    asyncio.run(story())


def test_what_never_waits_has_no_rest_and_what_it_raises_is_raised() -> None:
    async def nothing() -> None:
        pass

    async def fail() -> None:
        raise ValueError("no")

    assert begin(nothing()) is None
    with pytest.raises(ValueError, match="no"):
        begin(fail())


def test_a_cancelled_rest_is_cancelled_where_it_waits_and_a_failure_is_its_tasks() -> None:
    async def story() -> None:
        ends: list[str] = []

        async def wait() -> None:
            try:
                await asyncio.get_running_loop().create_future()
            except asyncio.CancelledError:
                ends.append("cancelled")
                raise

        async def fail() -> None:
            await asyncio.sleep(0)
            raise ValueError("late")

        rest = begin(wait())
        assert rest is not None
        task = asyncio.create_task(rest)
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert ends == ["cancelled"]
        rest = begin(fail())
        assert rest is not None
        with pytest.raises(ValueError, match="late"):
            await rest

    asyncio.run(story())
