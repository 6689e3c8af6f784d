"""What a base station may set in a backpack, and what becomes of a Configure (WIRE_FORMAT.md §6.6). No I/O, no clock."""

from dataclasses import dataclass, replace

from firmware_protocol.messages import LEAVE_PERIOD, LEAVE_RSSI, ConfigurationReport, ConfigurationResult, Configure
from simulator.backpacks.backpack_config import BackpackConfig
from simulator.backpacks.contacts import whole_dbm
from simulator.radios.proximity import ProximityConfig

SHORTEST_BEACON_PERIOD_MS = 100
"""One attempt to send may take some 35 ms; a backpack is to be done with one beacon before the next."""


@dataclass(slots=True, kw_only=True)
class Settings:
    """Values in force; they hold until the backpack restarts.

    Parameters
    ----------
    report_period_ms
        An encounter waits at most this long for others to share its message [ms].
    beacon_period_ms, proximity
        Pause between beacons [ms], and how encounters are formed from them; 0 and None where encounters are sensed continuously: then
        neither can be set.
    """

    report_period_ms: int
    beacon_period_ms: int
    proximity: ProximityConfig | None

    @classmethod
    def at_boot(cls, config: BackpackConfig) -> "Settings":
        """Return what a backpack begins with."""
        return cls(report_period_ms=config.report_period_ms, beacon_period_ms=config.beacon_period_ms, proximity=config.proximity)

    def apply(self, wanted: Configure) -> ConfigurationResult:
        """Set all that is wanted, or nothing."""
        is_of_beacons = (
            wanted.beacon_period_ms != LEAVE_PERIOD
            or wanted.gap_tolerance_ms != LEAVE_PERIOD
            or wanted.rssi_enter_dbm != LEAVE_RSSI
            or wanted.rssi_exit_dbm != LEAVE_RSSI
        )
        if is_of_beacons:
            if self.proximity is None or not self.beacon_period_ms:
                return ConfigurationResult.NOT_SUPPORTED
            enter_dbm = self.proximity.enter_dbm if wanted.rssi_enter_dbm == LEAVE_RSSI else float(wanted.rssi_enter_dbm)
            exit_dbm = self.proximity.exit_dbm if wanted.rssi_exit_dbm == LEAVE_RSSI else float(wanted.rssi_exit_dbm)
            if exit_dbm > enter_dbm or 0 < wanted.beacon_period_ms < SHORTEST_BEACON_PERIOD_MS:
                return ConfigurationResult.BAD_PARAMETER
            gap_ms = wanted.gap_tolerance_ms or self.proximity.gap
            self.proximity = replace(self.proximity, enter_dbm=enter_dbm, exit_dbm=exit_dbm, gap=gap_ms)
            self.beacon_period_ms = wanted.beacon_period_ms or self.beacon_period_ms
        self.report_period_ms = wanted.report_period_ms or self.report_period_ms
        return ConfigurationResult.DONE

    def report(self, token: int, result: ConfigurationResult) -> ConfigurationReport:
        """Tell all values in force."""
        proximity = self.proximity
        return ConfigurationReport(
            token=token,
            result=result,
            beacon_period_ms=self.beacon_period_ms,
            rssi_enter_dbm=LEAVE_RSSI if proximity is None else whole_dbm(proximity.enter_dbm),
            rssi_exit_dbm=LEAVE_RSSI if proximity is None else whole_dbm(proximity.exit_dbm),
            gap_tolerance_ms=LEAVE_PERIOD if proximity is None else min(proximity.gap, 0xFFFF),
            report_period_ms=min(self.report_period_ms, 0xFFFF),
        )
