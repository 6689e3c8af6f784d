"""Laws of injected faults: the same seed and bytes are harmed alike, however cut; a faulty dongle answers everything once."""

import asyncio
import itertools
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.envelope import RadioReceived, RadioSend, RadioStatus
from firmware_protocol.messages import HelloRequest
from firmware_protocol.units import RssiDbm, ShortAddress
from simulator.__main__ import main
from simulator.dongles.native import NativeDongle
from simulator.lines.byte_damage import ByteDamage
from simulator.lines.faults import ByteFault, Direction, FaultConfig, FaultDraws, SpellKind
from simulator.lines.faulty_dongle import FaultyDongle, with_faults
from simulator.lines.faulty_line import FaultyLine
from simulator.lines.line import SerialEnd
from simulator.lines.tcp_port import TcpEnd
from simulator.lines.virtual_serial import PtyEnd
from tests.simulator.base_station import BaseStation

S = 1_000_000_000
RATES = st.floats(0, 0.5, allow_nan=False)


def draws(*, seed: int = 1, line: int = 0, **faults: Any) -> FaultDraws:
    """Values come under the names of ``FaultConfig``."""
    return FaultDraws(config=FaultConfig(**faults), seed=seed, line=line)


@given(
    data=st.binary(max_size=400), cuts=st.lists(st.integers(0, 400)), seed=st.integers(0, 2**64 - 1),
    rates=st.fixed_dictionaries({kind.value: RATES for kind in ByteFault}),
)  # fmt: skip
def test_any_chunking_is_harmed_alike(data: bytes, cuts: list[int], seed: int, rates: dict[str, Any]) -> None:
    whole, pieces = (ByteDamage(draws(seed=seed, **rates), Direction.UP) for _ in range(2))
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    assert whole.apply(data) == b"".join(pieces.apply(data[a:b]) for a, b in itertools.pairwise(places))
    assert whole.counts == pieces.counts


def test_each_kind_does_what_it_says_as_often_as_it_says() -> None:
    """Of 100,000 bytes a hundredth is hit: 1,000, give or take five standard deviations of 31."""
    data = bytes(range(200)) * 500
    lengths = {}
    for kind in ByteFault:
        rate: dict[str, Any] = {kind.value: 0.01}
        damage = ByteDamage(draws(seed=7, **rate), Direction.DOWN)
        harmed = damage.apply(data)
        assert abs(damage.counts[kind] - 1000) < 160
        lengths[kind] = len(harmed) - len(data)
        if kind is ByteFault.BIT_FLIP:
            turned = [(one ^ other).bit_count() for one, other in zip(data, harmed, strict=True) if one != other]
            assert set(turned) == {1}
            assert len(turned) == damage.counts[kind]
        assert lengths[kind] == {ByteFault.BIT_FLIP: 0, ByteFault.DROP: -damage.counts[kind], ByteFault.INSERT: damage.counts[kind]}.get(
            kind, lengths[kind]
        )
    assert lengths[ByteFault.TRUNCATE] < -10 * 1000


def test_seed_line_and_direction_each_change_the_draws_and_nothing_else_does() -> None:
    data = bytes(5000)

    def harmed(seed: int, line: int, direction: Direction) -> bytes:
        return ByteDamage(draws(seed=seed, line=line, bit_flip=0.01), direction).apply(data)

    first = harmed(1, 0, Direction.UP)
    assert harmed(1, 0, Direction.UP) == first
    assert len({first, harmed(2, 0, Direction.UP), harmed(1, 1, Direction.UP), harmed(1, 0, Direction.DOWN)}) == 4
    assert ByteDamage(draws(bit_flip=0.01, direction="down"), Direction.UP).apply(data) == data


def test_spells_of_one_kind_do_not_overlap_and_come_as_often_as_asked() -> None:
    """Between two spells pass 2 s on average; the mean of 400 exponential waits is within a fifth of that."""
    spells = list(itertools.islice(draws(stall=0.5, stall_s=3).spells(SpellKind.STALL), 400))
    assert {spell.end_ns - spell.begin_ns for spell in spells} == {3 * S}
    gaps = [later.begin_ns - earlier.end_ns for earlier, later in itertools.pairwise(spells)]
    assert min(gaps) >= 0
    assert abs(sum(gaps) / len(gaps) / S - 2) < 0.4
    assert not list(draws().spells(SpellKind.STALL))


def test_rates_too_small_to_matter_do_nothing_and_break_nothing() -> None:
    tiny = 5e-324
    assert ByteDamage(draws(bit_flip=tiny), Direction.UP).apply(bytes(100)) == bytes(100)
    assert next(draws(reset=tiny).spells(SpellKind.RESET)).begin_ns > 10**18


def test_lines_are_counted_from_one_and_the_others_have_no_faults() -> None:
    config = FaultConfig(unplug=1.0, lines=(2,))
    assert config.of_line(0) is None
    assert config.of_line(1) is config
    assert FaultConfig().of_line(0) is None
    dongle = NativeDongle()
    assert with_faults(dongle, config, seed=1, line=0) is dongle


@pytest.mark.parametrize(
    ("flag", "words"),
    [
        ("bitflip=1", "bit_flip"), ("bit-flip", "bit-flip=1e-4"), ("bit-flip=0.9", "0.5"), ("bit-flip=x", "float"), ("stall=nan", "stall"),
        ("lines=0", "--fault 'lines=0'"), ("lines=a", "--fault 'lines=a'"),
        ("bit-flip=2", "--fault 'bit-flip=2': Expected `float` <= 0.5; docs/wire.md"),
        ("direction=left", "direction=left"), ("stall-s=0", "0.01"),
    ],
)  # fmt: skip
def test_a_wrong_fault_is_told_with_what_is_wanted(flag: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["serve", "--scenario", "no-obstacle", "--seed", "1", "--link", "tcp:127.0.0.1:0", "--fault", flag]
    try:
        status = main(arguments)
    except SystemExit as refused:
        status = int(str(refused.code))
    assert status == 2
    assert words in capsys.readouterr().err


class Cable:
    """Base station and dongle in one memory, in steps of 10 ms; every request is confirmed as sent, one step later."""

    def __init__(self, dongle: FaultyDongle) -> None:
        self.base, self.dongle, self.now_ns = BaseStation(), dongle, 0
        self.confirmed = 0
        dongle.start(now_ns=0)

    def run(self, for_s: float) -> None:
        launched: list[RadioSend] = []
        for _ in range(round(for_s * 100)):
            self.now_ns += S // 100
            self.base.tick(self.now_ns)
            self.dongle.feed(self.base.take_outgoing(), now_ns=self.now_ns)
            for request in launched:
                self.dongle.confirm(request.handle, RadioStatus.SENT, now_ns=self.now_ns)
                self.confirmed += 1
            launched = list(self.dongle.requests)
            self.dongle.requests.clear()
            due = self.dongle.next_deadline_ns()
            if due is not None and due <= self.now_ns:
                self.dongle.handle_deadline(now_ns=self.now_ns)
            self.base.feed(self.dongle.take_bytes(), now_ns=self.now_ns)


def heard(number: int) -> RadioReceived:
    return RadioReceived(source=ShortAddress(7), rssi_dbm=RssiDbm(-50), lqi=200, payload=bytes([number]))


def test_a_reset_loses_what_was_in_memory_and_the_base_station_opens_it_again() -> None:
    dongle = FaultyDongle(NativeDongle(), draws(reset=0.05, reset_s=0.5))
    cable = Cable(dongle)
    first = next(draws(reset=0.05, reset_s=0.5).spells(SpellKind.RESET))
    cable.run(first.begin_ns / S - 0.05)
    states = [dongle.is_open]
    cable.run(0.1)
    states.append(dongle.is_open)
    assert not dongle.take_from_radio(heard(1), eui64=1, now_ns=cable.now_ns)
    assert dongle.take_bytes() == b""
    cable.run(3.0)
    assert dongle.counts["reset"] >= 1
    assert [*states, dongle.is_open] == [True, False, True], "the base station has noticed, and opened it anew"
    assert dongle.take_from_radio(heard(2), eui64=1, now_ns=cable.now_ns)


def test_answers_of_the_radio_to_requests_from_before_a_reset_are_not_told() -> None:
    faults = draws(reset=0.2, reset_s=0.1)
    dongle = FaultyDongle(NativeDongle(), faults)
    cable = Cable(dongle)
    begin_s = next(faults.spells(SpellKind.RESET)).begin_ns / S
    cable.run(begin_s - 0.1)
    handle = cable.base.send(ShortAddress(5), HelloRequest(), now_ns=cable.now_ns)
    dongle.feed(cable.base.take_outgoing(), now_ns=cable.now_ns)
    (request,) = dongle.requests
    assert request.handle == handle
    dongle.requests.clear()  # the swarm has launched it
    cable.run(2.0)
    assert dongle.is_open
    dongle.confirm(handle, RadioStatus.SENT, now_ns=cable.now_ns)
    assert dongle.take_bytes() == b"", "the dongle knows nothing of it"
    again = cable.base.send(ShortAddress(5), HelloRequest(), now_ns=cable.now_ns)
    cable.run(0.5)
    assert [one.handle for one in cable.base.confirms][-1:] == [again]


def test_a_full_dongle_takes_nothing_and_refuses_every_request() -> None:
    faults = draws(full=0.2, full_s=1.0)
    dongle = FaultyDongle(NativeDongle(), faults)
    cable = Cable(dongle)
    cable.run(next(faults.spells(SpellKind.FULL)).begin_ns / S + 0.1)
    assert dongle.is_open
    assert not dongle.take_from_radio(heard(1), eui64=1, now_ns=cable.now_ns)
    cable.base.send(ShortAddress(5), HelloRequest(), now_ns=cable.now_ns)
    cable.run(0.2)
    assert [one.status for one in cable.base.confirms] == [RadioStatus.QUEUE_FULL]
    assert cable.confirmed == 0
    cable.run(1.0)
    assert dongle.take_from_radio(heard(2), eui64=1, now_ns=cable.now_ns)


def test_untrue_outcomes_are_told_as_often_as_asked_and_every_request_has_one() -> None:
    dongle = FaultyDongle(NativeDongle(), draws(wrong_status=0.5))
    cable = Cable(dongle)
    cable.run(0.5)
    for _ in range(40):
        for _ in range(5):
            cable.base.send(ShortAddress(5), HelloRequest(), now_ns=cable.now_ns)
        cable.run(0.1)
    told = Counter(one.status for one in cable.base.confirms)
    assert told.total() == 200
    assert told.total() - told[RadioStatus.SENT] == dongle.counts["wrong_status"]
    assert 60 < dongle.counts["wrong_status"] < 140
    assert len(told) > 4


def test_a_pulled_cable_ends_what_waits_and_the_line_comes_back_under_its_name(tmp_path: Path) -> None:
    async def story(end: SerialEnd) -> None:
        line = FaultyLine(end, draws(unplug=1.0))
        address = line.address
        reading = asyncio.ensure_future(line.read())
        await asyncio.sleep(0)
        await line.unplug()
        assert not (tmp_path / "dongle").is_symlink()
        await line.write(b"into the void")
        assert not reading.done()
        await line.plug_in()
        assert line.address == address
        if isinstance(end, TcpEnd):
            _, writer = await asyncio.open_connection(*address.removeprefix("tcp:").rsplit(":", 1))
            writer.write(b"hello")
            assert await reading == b"hello"
            writer.close()
        else:
            with (tmp_path / "dongle").open("wb", buffering=0) as port:
                port.write(b"hello")
                assert await reading == b"hello"
        await line.unplug()
        await line.aclose()

    async def both() -> None:
        await story(await TcpEnd.listen("127.0.0.1", 0))
        await story(PtyEnd(tmp_path / "dongle"))

    asyncio.run(both())


def test_what_comes_during_a_stall_comes_after_it(tmp_path: Path) -> None:
    async def story() -> None:
        line = FaultyLine(PtyEnd(tmp_path / "dongle"), draws(stall=1.0))
        await line.stall()
        reading = asyncio.ensure_future(line.read())
        with (tmp_path / "dongle").open("wb", buffering=0) as port:
            port.write(b"hello")
            done, _ = await asyncio.wait({reading}, timeout=0.2)
            assert not done
            await line.go_on()
            assert await reading == b"hello"
        await line.aclose()

    asyncio.run(story())
