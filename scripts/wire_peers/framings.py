"""Cut streams into frames with another library's code, for comparisons: ``python framings.py zigpy-xbee``.

A program of its own, because zigpy-xbee and zigpy-znp are under the GPL. It reads a JSON object a line, ``{"chunks": [hex, ...], "rounds":
N}``, lets a fresh decoder take the chunks N times, and writes ``{"bodies": [hex, ...], "seconds": S}``: the sound frames' data of the first
round, and the least processor time of a round. An unknown library, or one that is not installed, ends it with a message.
"""

import io
import json
import logging
import sys
import time
from collections.abc import Callable
from typing import Any

Bodies = list[bytes]
Round = Callable[[list[bytes]], list[object]]


def digi_xbee(*, is_escaped: bool) -> tuple[Round, Callable[[object], bytes]]:
    """Wait for a frame and build it, as its reading thread does; only the serial port's ``read`` is replaced, by one from memory."""
    import digi.xbee.devices  # noqa: F401, PLC0415  # its modules import each other in this order alone
    from digi.xbee.models.mode import OperatingMode  # noqa: PLC0415
    from digi.xbee.packets.factory import build_frame  # noqa: PLC0415
    from digi.xbee.serial import XBeeSerialPort  # noqa: PLC0415

    class Memory(XBeeSerialPort):
        def __init__(self, data: bytes) -> None:
            super().__init__(9600, None)
            self.rest = io.BytesIO(data)
            self.is_over = False

        def read(self, size: int = 1) -> bytes:
            data = self.rest.read(size)
            self.is_over = not data
            return data

    mode = OperatingMode.ESCAPED_API_MODE if is_escaped else OperatingMode.API_MODE

    def run(chunks: list[bytes]) -> list[object]:
        port, found = Memory(b"".join(chunks)), []
        while not port.is_over:
            raw = port.wait_for_frame(mode)
            if raw is None:
                continue
            try:
                build_frame(raw, operating_mode=OperatingMode.API_MODE)
            except Exception:  # noqa: BLE001, S112  # it raises many kinds for a frame that is none
                continue
            found.append(bytes(raw[3:-1]))
        return found

    return run, bytes


def zigpy_xbee() -> tuple[Round, Callable[[object], bytes]]:
    """Give chunks to the protocol that its serial port is connected to."""
    from zigpy_xbee.uart import Gateway  # noqa: PLC0415

    return _collect(Gateway), bytes


def zigpy_znp() -> tuple[Round, Callable[[object], bytes]]:
    """Give chunks to the protocol that its serial port is connected to."""
    from zigpy_znp.uart import ZnpMtProtocol  # noqa: PLC0415

    return _collect(ZnpMtProtocol), lambda frame: frame.serialize()[1:]  # without the length


class _Api:
    """Takes frames as the owners of zigpy's serial protocols do."""

    def __init__(self) -> None:
        self.found: list[object] = []

    def frame_received(self, frame: object) -> None:
        self.found.append(frame)


def _collect(protocol_class: Callable[[_Api], Any]) -> Round:
    def run(chunks: list[bytes]) -> list[object]:
        api = _Api()
        protocol = protocol_class(api)
        for chunk in chunks:
            protocol.data_received(chunk)
        return api.found

    return run


def main() -> int:
    """Answer requests until the input ends."""
    makers = {
        "digi-xbee-1": lambda: digi_xbee(is_escaped=False),
        "digi-xbee-2": lambda: digi_xbee(is_escaped=True),
        "zigpy-xbee": zigpy_xbee,
        "zigpy-znp": zigpy_znp,
    }
    if len(sys.argv) != 2 or sys.argv[1] not in makers:
        print(f"error: {sys.argv[1:]}; wanted one of {', '.join(makers)}", file=sys.stderr)
        return 2
    try:
        run, body_of = makers[sys.argv[1]]()
    except ImportError as error:
        print(f"error: {error}; run: make wire-peers", file=sys.stderr)
        return 1
    logging.disable(logging.CRITICAL)
    for line in sys.stdin:
        request = json.loads(line)
        chunks = [bytes.fromhex(chunk) for chunk in request["chunks"]]
        least = float("inf")
        first = None
        for _ in range(request["rounds"]):
            begin = time.process_time()
            found = run(chunks)
            least = min(least, time.process_time() - begin)
            first = found if first is None else first
        print(json.dumps({"bodies": [body_of(one).hex() for one in first or []], "seconds": least}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
