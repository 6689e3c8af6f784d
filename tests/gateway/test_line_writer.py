"""Laws of frames on a port: whole, in order, each once, whoever writes them."""

import asyncio
from collections import deque

from hypothesis import given
from hypothesis import strategies as st

from gateway.line_pace import LinePace
from gateway.line_writer import LineWriter


class _Port:
    """Takes at once as many bytes of each frame as it is told, and the rest when it is waited for."""

    name = "port"

    def __init__(self, takes: list[int]) -> None:
        self.line = b""
        self._takes = deque(takes)

    async def read(self) -> bytes:
        raise AssertionError

    async def write(self, data: bytes) -> None:
        await asyncio.sleep(0)
        self.line += data

    def write_at_once(self, data: bytes) -> bytes:
        n_taken = self._takes.popleft() if self._takes else len(data)
        self.line += data[:n_taken]
        return data[n_taken:]

    async def aclose(self) -> None:
        raise AssertionError


@given(
    frames=st.lists(st.binary(min_size=1, max_size=8), max_size=30),
    takes=st.lists(st.integers(0, 8), max_size=30),
    turns=st.lists(st.booleans(), max_size=60),
)
def test_frames_that_are_written_at_once_and_by_the_task_come_whole_and_in_order(
    frames: list[bytes], takes: list[int], turns: list[bool]
) -> None:
    async def story() -> bytes:
        port, waiting = _Port(takes), deque(frames)
        line = LineWriter(port, pace=LinePace(bytes_per_s=None))

        def next_frame(_now_ns: int) -> bytes | None:
            line.write_at_once(next_frame)  # whoever makes a frame may send something urgent: it has its turn after this one
            return waiting.popleft() if waiting else None

        for is_task in turns:
            writing = asyncio.create_task(line.write_what_fits(next_frame)) if is_task else None
            await asyncio.sleep(0)
            line.write_at_once(next_frame)
            if writing is not None:
                await writing
        await line.write_what_fits(next_frame)
        return port.line

    assert asyncio.run(story()) == b"".join(frames)


def test_nothing_is_written_while_the_line_is_not_free() -> None:
    port = _Port([])
    line = LineWriter(port, pace=LinePace(bytes_per_s=10.0))
    waiting = deque([b"x" * 200, b"y"])
    line.write_at_once(lambda _: waiting.popleft())
    assert list(waiting) == [b"y"]
    assert port.line == b"x" * 200
