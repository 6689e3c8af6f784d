"""Calls that may hang for ever, each in a thread of its own, so that no shared pool can be used up by them.

Opening or closing a device, and asking for the address of a host, may hang in the operating system for minutes or for good, and no thread
can be stopped from outside. A call that is late is left to its thread: what it returns after all is handed to ``dispose``, and whoever
asked is told with ``OverdueError``, whose ``is_over`` says when the thread has come back. Until then the same thing should not be asked
again: so a port that hangs costs one thread, however long it is tried.
"""

import asyncio
import threading
from collections.abc import Callable
from functools import partial
from typing import Generic, TypeVar

_ResultT = TypeVar("_ResultT")


class OverdueError(Exception):
    """A call did not return in time; its thread goes on."""

    def __init__(self, *, timeout_s: float, is_over: Callable[[], bool]) -> None:
        super().__init__(f"no return within {timeout_s:g} s")
        self.is_over = is_over


async def call_in_own_thread(
    function: Callable[[], _ResultT], *, name: str, timeout_s: float, dispose: Callable[[_ResultT], None] | None = None
) -> _ResultT:
    """Return what ``function`` returns, or raise what it raises.

    Parameters
    ----------
    name
        Of the thread.
    timeout_s
        How long it is waited for [s].
    dispose
        Is given what came too late, or after this call was cancelled.

    Raises
    ------
    OverdueError
        It did not return in time.
    """
    call = _Call(function, dispose)
    threading.Thread(target=call.run, name=name, daemon=True).start()
    try:
        async with asyncio.timeout(timeout_s):
            return await call.future
    except TimeoutError as error:
        if call.future.done() and not call.future.cancelled():  # the function's own TimeoutError, or it came at the last moment
            return call.future.result()
        raise OverdueError(timeout_s=timeout_s, is_over=lambda: call.is_over) from error
    except asyncio.CancelledError:
        call.give_back()
        raise


class _Call(Generic[_ResultT]):
    """One call. A future that is cancelled is the sign that nobody waits any more."""

    def __init__(self, function: Callable[[], _ResultT], dispose: Callable[[_ResultT], None] | None) -> None:
        self._loop = asyncio.get_running_loop()
        self.future: asyncio.Future[_ResultT] = self._loop.create_future()
        self.is_over = False
        self._function = function
        self._dispose = dispose

    def run(self) -> None:
        """Be the thread."""
        try:
            result = self._function()
        except BaseException as error:  # noqa: BLE001  # all of it is the caller's
            self._tell(partial(self._fail, error))
        else:
            if not self._tell(partial(self._succeed, result)):
                self._drop(result)
        finally:
            self.is_over = True

    def give_back(self) -> None:
        """Drop a result that has come and that nobody will take."""
        if self.future.done() and not self.future.cancelled() and self.future.exception() is None:
            self._drop(self.future.result())

    def _tell(self, step: Callable[[], None]) -> bool:
        try:
            self._loop.call_soon_threadsafe(step)
        except RuntimeError:  # the loop has ended
            return False
        return True

    def _succeed(self, result: _ResultT) -> None:
        if self.future.done():
            threading.Thread(target=self._drop, args=(result,), daemon=True).start()  # it may hang, too
        else:
            self.future.set_result(result)

    def _fail(self, error: BaseException) -> None:
        if not self.future.done():
            self.future.set_exception(error)

    def _drop(self, result: _ResultT) -> None:
        if self._dispose is not None:
            self._dispose(result)
