"""Whether the pulse train of the configuration is within what a backpack has announced. Pure.

The table in the configuration is the gateway's own limit and is checked when it is read; what a backpack announces makes it stricter, never
looser. A refusal names both.
"""

from firmware_protocol.contract.commands import WaveformName
from firmware_protocol.messages import OWN_CHANNEL, Limits, Waveform
from gateway.config import StimulationTable

WAVEFORMS = {
    WaveformName.SYMMETRIC: Waveform.SYMMETRIC_BIPHASIC,
    WaveformName.ASYMMETRIC: Waveform.ASYMMETRIC_BIPHASIC,
    WaveformName.MONOPHASIC: Waveform.MONOPHASIC,
}


def pulse_refusal(table: StimulationTable, limits: Limits) -> str | None:
    """Return why a backpack with these limits must not be given the table's train, or None."""
    for key, unit, wanted, limit in (
        ("frequency_hz", "Hz", table.frequency_hz, limits.max_frequency_hz),
        ("pulse_width_us", "us", table.pulse_width_us, limits.max_pulse_width_us),
        ("amplitude_mv", "mV", table.amplitude_mv, limits.max_amplitude_mv),
        ("duration_ms", "ms", table.duration_ms, limits.max_duration_ms),
    ):
        if wanted > limit:
            return (
                f"the configuration says stimulation.{key} = {wanted} {unit}, but this backpack takes at most {limit} {unit}; "
                f"set stimulation.{key} to {limit} or less"
            )
    if table.channel == OWN_CHANNEL:
        if not limits.channels:
            return "the configuration leaves the channel to the backpack (stimulation.channel = 255), but this backpack has no channels"
    elif not limits.channels >> table.channel & 1:
        return f"the configuration says stimulation.channel = {table.channel}, but this backpack has {_channels(limits.channels)}"
    if not limits.waveforms >> WAVEFORMS[table.waveform] & 1:
        names = [name.value for name, waveform in WAVEFORMS.items() if limits.waveforms >> waveform & 1]
        known = " and ".join(names) or "none that is known here"
        return f"the configuration says stimulation.waveform = {table.waveform.value}, but this backpack makes {known}"
    return None


def _channels(bits: int) -> str:
    there = [str(channel) for channel in range(8) if bits >> channel & 1]
    return f"channels {', '.join(there)}" if there else "no channels"
