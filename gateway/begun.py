"""A coroutine that runs as far as it can at once, not in a later turn of the event loop: what a stop sends does not wait for its turn.

Python 3.12 has eager tasks for this; here it is for all versions. Until the first wait no task is the current one, so nothing before it may
need that: ``asyncio.timeout`` and task groups do.
"""

import types
from collections.abc import Coroutine, Generator
from functools import partial
from typing import Any


def begin(coroutine: Coroutine[Any, Any, None]) -> Coroutine[Any, Any, None] | None:
    """Run a coroutine up to where it first waits; return what runs the rest when it is awaited, None where there is no rest.

    What it raises before its first wait is raised here.
    """
    try:
        awaited = coroutine.send(None)
    except StopIteration:
        return None
    return _rest(coroutine, awaited)


async def _rest(coroutine: Coroutine[Any, Any, None], awaited: object) -> None:
    await _resume(coroutine, awaited)


@types.coroutine
def _resume(coroutine: Coroutine[Any, Any, None], awaited: object) -> Generator[object, object, None]:
    """Wait for what the coroutine waits for, on its behalf."""
    while True:
        try:
            answer = yield awaited
        except GeneratorExit:
            coroutine.close()
            raise
        except BaseException as error:  # noqa: BLE001  # it is the coroutine's own affair, a cancellation too
            go_on = partial(coroutine.throw, error)
        else:
            go_on = partial(coroutine.send, answer)
        try:
            awaited = go_on()
        except StopIteration:
            return
