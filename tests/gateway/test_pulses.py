"""Laws of the pulse train that a command gives, and of what the configuration and a backpack forbid."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from firmware_protocol.contract.commands import PulseRequest, Refusal, WaveformName
from firmware_protocol.messages import Limits
from gateway.config import StimulationTable
from gateway.stimulation.pulses import WAVEFORMS, Pulse, pulse_of, pulse_refusal

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


def _refusal(table: StimulationTable, limits: Limits | None, asked: PulseRequest | None = None) -> str | None:
    refused = pulse_refusal(pulse_of(asked, table), table=table, limits=limits)
    assert refused is None or refused.refusal is Refusal.PULSE
    return None if refused is None else refused.reason


@pytest.mark.parametrize("key", ["frequency_hz", "pulse_width_us", "amplitude_mv", "duration_ms"])
def test_a_limit_below_the_table_refuses_and_names_both(key: str) -> None:
    value = getattr(TABLE, key)

    assert _refusal(TABLE, replace(WIDE, **{f"max_{key}": value})) is None
    refusal = _refusal(TABLE, replace(WIDE, **{f"max_{key}": value - 1}))
    assert refusal is not None
    assert f"stimulation.{key} = {value} " in refusal
    assert f"at most {value - 1} " in refusal


def test_a_channel_that_is_not_there_is_refused_only_where_the_backpack_says_so() -> None:
    for channel in range(8):
        refusal = _refusal(StimulationTable(channel=channel), WIDE)
        assert (refusal is None) is (channel < 3)
    assert "channels 0, 1, 2" in (_refusal(StimulationTable(channel=5), WIDE) or "")
    assert _refusal(TABLE, WIDE) is None
    assert "has no channels" in (_refusal(TABLE, replace(WIDE, channels=0)) or "")


@pytest.mark.parametrize("waveform", WaveformName)
def test_a_waveform_that_cannot_be_made_is_refused(waveform: WaveformName) -> None:
    refusal = _refusal(StimulationTable(waveform=waveform), WIDE)

    assert (refusal is None) is (waveform is not WaveformName.MONOPHASIC)
    assert refusal is None or "makes symmetric and asymmetric" in refusal
    assert "makes none" in (_refusal(StimulationTable(waveform=waveform), replace(WIDE, waveforms=0)) or "")


_asked = st.builds(
    PulseRequest,
    frequency_hz=st.none() | st.integers(45, 60) | st.integers(1, 255),
    pulse_width_us=st.none() | st.integers(1, 12_000),
    amplitude_mv=st.none() | st.integers(1_500, 2_500) | st.integers(0, 0xFFFF),
    duration_ms=st.none() | st.integers(0, 600),
    channel=st.none() | st.integers(0, 9) | st.just(255),
    waveform=st.none() | st.sampled_from(WaveformName),
)
_tables = st.builds(
    StimulationTable,
    min_frequency_hz=st.integers(40, 50),
    max_frequency_hz=st.integers(50, 150),
    max_amplitude_mv=st.integers(1_000, 4_000),
    max_pulse_width_us=st.integers(4_000, 10_000),
    max_duration_ms=st.integers(300, 500),
    allows_unbalanced=st.booleans(),
)
_limits = st.builds(
    lambda channels, waveforms, frequency, width, amplitude, duration: replace(
        WIDE,
        channels=channels,
        waveforms=waveforms,
        max_frequency_hz=frequency,
        max_pulse_width_us=width,
        max_amplitude_mv=amplitude,
        max_duration_ms=duration,
    ),
    st.integers(0, 7),
    st.integers(0, 7),
    st.integers(40, 150),
    st.integers(3_000, 10_000),
    st.integers(1_000, 4_000),
    st.integers(100, 1_000),
)


@given(_asked, _tables, st.none() | _limits)
def test_a_train_is_admitted_exactly_where_it_is_within_every_limit(
    asked: PulseRequest, table: StimulationTable, limits: Limits | None
) -> None:
    pulse = pulse_of(asked, table)
    refusal = _refusal(table, limits, asked)

    assert (refusal is None) is (
        pulse.duration_ms == 0 or (_is_within_table(pulse, table) and (limits is None or _is_within(pulse, limits)))
    )
    assert refusal is None or "; " in refusal, "it says what would do"


def _is_within_table(pulse: Pulse, table: StimulationTable) -> bool:
    n_phases = 1 if pulse.waveform is WaveformName.MONOPHASIC else 2
    return (
        table.min_frequency_hz <= pulse.frequency_hz <= table.max_frequency_hz
        and pulse.amplitude_mv <= table.max_amplitude_mv
        and pulse.pulse_width_us <= table.max_pulse_width_us
        and pulse.duration_ms <= table.max_duration_ms
        and n_phases * pulse.pulse_width_us * pulse.frequency_hz <= 1_000_000
        and (pulse.channel <= 7 or pulse.channel == 255)
        and (pulse.waveform is not WaveformName.MONOPHASIC or table.allows_unbalanced)
    )


def _is_within(pulse: Pulse, limits: Limits) -> bool:
    has_channel = limits.channels > 0 if pulse.channel == 255 else pulse.channel in {n for n in range(8) if limits.channels & (1 << n)}
    return (
        has_channel
        and pulse.frequency_hz <= limits.max_frequency_hz
        and pulse.pulse_width_us <= limits.max_pulse_width_us
        and pulse.amplitude_mv <= limits.max_amplitude_mv
        and pulse.duration_ms <= limits.max_duration_ms
        and bool(limits.waveforms & (1 << WAVEFORMS[pulse.waveform]))
    )


def test_what_a_command_asks_for_is_blamed_on_the_command_and_the_rest_on_the_configuration() -> None:
    assert _refusal(TABLE, None, PulseRequest(amplitude_mv=3_000)) == (
        "it asks for amplitude_mv = 3000 mV, but stimulation.max_amplitude_mv is 2000 mV; ask for 2000 or less"
    )
    assert _refusal(StimulationTable(amplitude_mv=3_000), None, PulseRequest(frequency_hz=55)) == (
        "the configuration says stimulation.amplitude_mv = 3000 mV, but stimulation.max_amplitude_mv is 2000 mV; "
        "set stimulation.amplitude_mv to 2000 or less, or ask for it in the command"
    )
