"""Laws of what a backpack's announced limits forbid."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from firmware_protocol.contract.commands import WaveformName
from firmware_protocol.messages import Limits
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.config import StimulationTable
from gateway.pulse_limits import pulse_refusal
from gateway.train_ledger import TrainLedger

TABLE = StimulationTable()
WIDE = Limits(
    channels=0b111,
    waveforms=0b011,
    max_frequency_hz=150,
    max_pulse_width_us=10_000,
    max_amplitude_mv=4_000,
    max_duration_ms=1_000,
    min_gap_ms=0,
    max_on_ms_per_minute=60_000,
    battery_mv=2_900,
    battery_empty_mv=2_000,
    encounter_capacity=256,
)


@pytest.mark.parametrize("key", ["frequency_hz", "pulse_width_us", "amplitude_mv", "duration_ms"])
def test_a_limit_below_the_table_refuses_and_names_both(key: str) -> None:
    value = getattr(TABLE, key)

    assert pulse_refusal(TABLE, replace(WIDE, **{f"max_{key}": value})) is None
    refusal = pulse_refusal(TABLE, replace(WIDE, **{f"max_{key}": value - 1}))
    assert refusal is not None
    assert f"stimulation.{key} = {value} " in refusal
    assert f"at most {value - 1} " in refusal


def test_a_channel_that_is_not_there_is_refused_only_where_the_backpack_says_so() -> None:
    for channel in range(8):
        refusal = pulse_refusal(StimulationTable(channel=channel), WIDE)
        assert (refusal is None) is (channel < 3)
    assert "channels 0, 1, 2" in (pulse_refusal(StimulationTable(channel=5), WIDE) or "")
    assert pulse_refusal(TABLE, WIDE) is None
    assert "has no channels" in (pulse_refusal(TABLE, replace(WIDE, channels=0)) or "")


@pytest.mark.parametrize("waveform", WaveformName)
def test_a_waveform_that_cannot_be_made_is_refused(waveform: WaveformName) -> None:
    refusal = pulse_refusal(StimulationTable(waveform=waveform), WIDE)

    assert (refusal is None) is (waveform is not WaveformName.MONOPHASIC)
    assert refusal is None or "makes symmetric and asymmetric" in refusal
    assert "makes none" in (pulse_refusal(StimulationTable(waveform=waveform), replace(WIDE, waveforms=0)) or "")


@given(st.integers(0, 10_000), st.integers(0, 20_000), st.lists(st.integers(0, 4_000), max_size=60))
def test_trains_keep_the_stricter_of_both_limits(min_gap_ms: int, max_on_ms: int, pauses_ms: list[int]) -> None:
    announced = replace(WIDE, min_gap_ms=min_gap_ms, max_on_ms_per_minute=max_on_ms)
    ledger, node, now_ns, admitted = TrainLedger(limits=TABLE), NodeId(1), 0, list[int]()
    for pause_ms in pauses_ms:
        now_ns += pause_ms * 1_000_000
        refusal = ledger.refusal(node, train_ms=500, now_ns=now_ns, announced=announced)
        if refusal is None:
            assert ledger.refusal(node, train_ms=500, now_ns=now_ns) is None, "what a backpack announces never loosens the table"
            ledger.admit(node, train_ms=500, at_ns=now_ns)
            admitted.append(now_ns)
    for earlier, later in itertools.pairwise(admitted):
        assert later - earlier >= max(2_000, min_gap_ms) * 1_000_000 + 500_000_000
    for at_ns in admitted:
        assert 500 * sum(at_ns - 60 * NS_PER_S < one <= at_ns for one in admitted) <= min(9_000, max_on_ms)
