"""What a backpack says of itself: who it is, what it can do, what its stimulator allows, how full its battery is. No I/O, no clock."""

from dataclasses import dataclass

from firmware_protocol.messages import Capability, Diagnostic, Hello, Level, Limits
from firmware_protocol.units import BootId
from simulator.backpacks.backpack_config import BackpackConfig
from simulator.backpacks.contacts import tick
from simulator.backpacks.stimulator import CHANNELS, MAX_AMPLITUDE_MV, MAX_DURATION_MS, MAX_FREQUENCY_HZ, MAX_PULSE_WIDTH_US, WAVEFORMS

STARTED = 1
"""Code of the Diagnostic at boot; its argument is the count of starts."""

# The voltage is taken to fall evenly over the battery's life to the 2.0 V at which a CC2530 stops (its datasheet).
_FULL_MV = 3_000
_EMPTY_MV = 2_000

_MINUTE_MS = 60_000
_MOST = 0xFFFF


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfDescription:
    """See the module.

    Parameters
    ----------
    booted_ms
        What the backpack's clock showed when the battery was full [ms].
    has_imu
        It measures how far it is carried.
    """

    eui64: int
    boot: BootId
    booted_ms: int
    config: BackpackConfig
    has_imu: bool

    def hello(self, *, beacon_period_ms: int) -> Hello:
        """Say who it is, and what it can do."""
        imu = Capability.IMU if self.has_imu else Capability(0)
        walls = Capability.FOLLOW_WALLS if self.config.can_follow_walls else Capability(0)
        return Hello(
            eui64=self.eui64,
            firmware=self.config.firmware,
            beacon_period_ms=beacon_period_ms,
            capabilities=Capability.STIMULATION | Capability.CONFIGURE | imu | walls,
        )

    def limits(self, *, now_ms: int) -> Limits:
        """Say what the stimulator can do and refuses to exceed."""
        return Limits(
            channels=CHANNELS,
            waveforms=WAVEFORMS,
            max_frequency_hz=MAX_FREQUENCY_HZ,
            max_pulse_width_us=MAX_PULSE_WIDTH_US,
            max_amplitude_mv=MAX_AMPLITUDE_MV,
            max_duration_ms=MAX_DURATION_MS,
            min_gap_ms=0,
            max_on_ms_per_minute=_MINUTE_MS,  # it keeps no account of trains: that is the base station's
            battery_mv=self.battery_mv(now_ms),
            battery_empty_mv=_EMPTY_MV,
            encounter_capacity=min(self.config.capacity, _MOST),
        )

    def started(self) -> Diagnostic:
        """Report the start."""
        return Diagnostic(level=Level.INFO, code=STARTED, argument=self.boot, at_ms=tick(self.booted_ms), text="started")

    def battery_mv(self, at_ms: int) -> int:
        """Return the battery's voltage [mV]."""
        return max(_EMPTY_MV, _FULL_MV - (_FULL_MV - _EMPTY_MV) * (at_ms - self.booted_ms) // self.config.battery_life_ms)
