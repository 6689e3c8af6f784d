"""A Z-Stack host and a virtual chip on one bench, with a wire between them."""

from dataclasses import dataclass, field

import pytest

from firmware_protocol.dialects.interface import (
    CoordinatorIdentified,
    HostEvent,
    PayloadHeard,
    SendSettled,
)
from firmware_protocol.dialects.znp import ZnpHost
from firmware_protocol.dialects.znp_opening import ZnpHostConfig
from firmware_protocol.envelope import RadioSend, RadioStatus
from firmware_protocol.framing.znp import ZnpDecoder, encode_frame
from firmware_protocol.units import ShortAddress
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.codec import Message, decode_command, encode_command
from simulator.dongles.znp import ZnpDongle, ZnpDongleConfig
from simulator.dongles.znp_stack import ZStack

MS = 1_000_000
S = 1_000 * MS
NODE = ShortAddress(0x1234)
EUI64 = 0x00124B00000000AA

CC2652 = ZnpDongleConfig()
CC2531 = ZnpDongleConfig(firmware=ZStack.V1_2)
CC2531_WITH_LOADER = ZnpDongleConfig(firmware=ZStack.V1_2, has_boot_loader=True)
every_chip = pytest.mark.parametrize("config", [CC2652, CC2531, CC2531_WITH_LOADER], ids=["cc2652", "cc2531", "cc2531-loader"])


@dataclass
class Bench:
    """A host and a chip with a wire between them; requests to the radio wait in ``dongle.requests`` until ``answer``.

    The chip may be ``stubborn``: requests of these kinds have the answer that stands there, or none.
    """

    dongle: ZnpDongle
    host: ZnpHost = field(default_factory=ZnpHost)
    now_ns: int = 0
    is_cut: bool = False
    events: list[HostEvent] = field(default_factory=list)
    asked: list[Message] = field(default_factory=list)
    stubborn: dict[type[Message], Message | None] = field(default_factory=dict)

    def open(self) -> None:
        self.events += self.host.open(session=0, now_ns=self.now_ns)

    def run(self, for_ms: int, *, step_ms: int = 10) -> None:
        for _ in range(for_ms // step_ms):
            self.now_ns += step_ms * MS
            deadline_ns = self.host.next_deadline_ns()
            if deadline_ns is not None and deadline_ns <= self.now_ns:
                self.events += self.host.handle_deadline(now_ns=self.now_ns)
            down = b"".join(one for one in self.host.take_frames() if not self._is_answered(one))
            if not self.is_cut:
                self.dongle.feed(down, now_ns=self.now_ns)
            due_ns = self.dongle.next_deadline_ns()
            if due_ns is not None and due_ns <= self.now_ns:
                self.dongle.handle_deadline(now_ns=self.now_ns)
            up = self.dongle.take_bytes()
            if not self.is_cut:
                self.events += self.host.feed(up, now_ns=self.now_ns)

    def _is_answered(self, written: bytes) -> bool:
        """Note what the host asks; answer it where the chip is stubborn."""
        is_answered = False
        for body in ZnpDecoder().feed(written):
            request = decode_command(body) if isinstance(body, bytes) else None
            if request is None or isinstance(request, znp.ZnpFault):
                continue
            self.asked.append(request)
            if type(request) in self.stubborn:
                is_answered = True
                answer = self.stubborn[type(request)]
                self.events += [] if answer is None else self.host.feed(frame(answer), now_ns=self.now_ns)
        return is_answered

    def run_until_open(self, *, within_ms: int = 30_000) -> None:
        for _ in range(within_ms // 50):
            if self.host.is_open:
                return
            self.run(50)
        pytest.fail(f"not open within {within_ms} ms: {self.events[-3:]}")

    def answer(self, status: RadioStatus = RadioStatus.SENT) -> list[RadioSend]:
        sent = list(self.dongle.requests)
        self.dongle.requests.clear()
        for one in sent:
            self.dongle.confirm(one.handle, status, now_ns=self.now_ns)
        return sent

    def of(self, kind: type[HostEvent]) -> list[HostEvent]:
        return [one for one in self.events if isinstance(one, kind)]

    def identified(self) -> CoordinatorIdentified:
        last = self.of(CoordinatorIdentified)[-1]
        assert isinstance(last, CoordinatorIdentified)
        return last


def a_bench(config: ZnpDongleConfig = CC2652, host: ZnpHostConfig | None = None) -> Bench:
    bench = Bench(dongle=ZnpDongle(config=config), host=ZnpHost(config=host))
    bench.dongle.start(now_ns=0)
    return bench


def opened(config: ZnpDongleConfig = CC2652, host: ZnpHostConfig | None = None) -> Bench:
    bench = a_bench(config, host)
    bench.open()
    bench.run_until_open()
    return bench


def heard(bench: Bench) -> list[PayloadHeard]:
    return [one for one in bench.events if isinstance(one, PayloadHeard)]


def settled(bench: Bench) -> dict[int, int]:
    return {one.ticket: one.status for one in bench.events if isinstance(one, SendSettled)}


def frame(message: Message) -> bytes:
    return encode_frame(encode_command(message))


def ask(dongle: ZnpDongle, request: Message) -> list[Message]:
    dongle.feed(frame(request), now_ns=S)
    answers = [decode_command(body) for body in ZnpDecoder().feed(dongle.take_bytes()) if isinstance(body, bytes)]
    return [one for one in answers if not isinstance(one, znp.ZnpFault)]


def a_running_dongle(config: ZnpDongleConfig = CC2652) -> ZnpDongle:
    dongle = ZnpDongle(config=config)
    dongle.start(now_ns=0)
    dongle.handle_deadline(now_ns=S)
    dongle.take_bytes()
    return dongle
