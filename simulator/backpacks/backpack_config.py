"""How a backpack reports and senses."""

from dataclasses import dataclass, field

from simulator.backpacks.outbox import OutboxConfig
from simulator.errors import ParameterError
from simulator.radios.proximity import ProximityConfig

_MODULUS = 1 << 16


@dataclass(frozen=True, slots=True, kw_only=True)
class BackpackConfig:
    """How a backpack reports.

    Parameters
    ----------
    report_period_ms
        An encounter waits at most this long for others to share its message [ms].
    status_period_ms, neighbours_period_ms
        How often state and neighbours are told [ms].
    provisional_ms
        An encounter that lasts longer is reported as ongoing, again each time this much has gone by [ms].
    capacity
        Encounters in the buffer at most; 256 of 10 bytes take 2.5 KiB of a CC2530's 8 KiB.
    spread_ms
        Hello, at boot and on a broadcast request, waits a random part of this, so that a swarm does not answer at once [ms].
    battery_life_ms
        The voltage told falls from full to empty over this, counted from boot [ms]. A CC2530 that listens all the time draws 24 mA
        (its datasheet), so a 50 mAh cell lasts two hours.
    insect_obeys
        False where the insect cannot be made to do anything, as in a replay: commands are answered, and the mode stays what is sensed.
    can_follow_walls
        It can have its insect keep to walls, and says so in Hello.
    beacon_period_ms
        What Hello says of it [ms]; 0: encounters are sensed continuously.
    proximity
        How encounters are formed from beacons, in milliseconds; None where none are heard.
    """

    report_period_ms: int = 1_000
    status_period_ms: int = 10_000
    neighbours_period_ms: int = 5_000
    provisional_ms: int = 30_000
    capacity: int = 256
    spread_ms: int = 1_000
    battery_life_ms: int = 2 * 3_600_000
    insect_obeys: bool = True
    can_follow_walls: bool = False
    firmware: int = 0x0001
    beacon_period_ms: int = 0
    proximity: ProximityConfig | None = None
    outbox: OutboxConfig = field(default_factory=OutboxConfig)

    def __post_init__(self) -> None:
        for name in ("report_period_ms", "status_period_ms", "neighbours_period_ms", "provisional_ms", "capacity", "battery_life_ms"):
            if getattr(self, name) < 1:
                raise ParameterError(name=name, got=getattr(self, name), wanted="at least 1")
        if not 0 <= self.beacon_period_ms < _MODULUS:
            raise ParameterError(
                name="beacon_period_ms", got=self.beacon_period_ms, wanted=f"0 to {_MODULUS - 1}: Hello has 16 bits for it"
            )
