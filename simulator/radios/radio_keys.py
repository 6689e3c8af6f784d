"""Keys of a configuration that say how radios are and how encounters are sensed; shared by ``run`` and ``serve``."""

from typing import Annotated, Literal

import msgspec

_Dbm = Annotated[float, msgspec.Meta(ge=-200, le=100)]
_Spread = Annotated[float, msgspec.Meta(ge=0, le=40)]
_Duration = Annotated[float, msgspec.Meta(ge=0, le=86_400)]


class RadioKeys(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How radios are and how encounters are sensed. A key that is not given takes the value of the radio's preset.

    The radio's keys speak of beacons; with ``csma`` the reports of backpacks that send beacons share their channel. Where sensing is
    ``ideal``, only ``tx_power_dbm``, ``loss_1m_db`` and ``exponent`` matter, for the strengths that are told.

    Keys
    ----
    sensing
        ``ideal``: encounters begin and end where the insects' centres pass the detection radius. ``beacon``: backpacks say who
        they are now and then, and take a neighbour that they hear loud enough for near.
    beacon_period_s
        Time between two beacons of one backpack [s].
    enter_dbm, exit_dbm
        An encounter is opened by a beacon at least as strong as the first, and kept by those at least as strong as the second [dBm].
        Without them: what the median path loss gives at the detection radius, and at 1.15 detection radii. A unit of length counts
        as a metre.
    gap_periods
        An encounter ends with the last beacon after which none comes for this many periods.
    min_beacons
        So many strong beacons in a row open an encounter; it then counts from the first of them.
    radio
        Preset of the radio: ``ideal``, ``indoor`` or ``rubble``.
    tx_power_dbm, loss_1m_db, exponent
        Path loss with distance: power sent, loss at 1 m, and how steeply power falls beyond (2: free space).
    shadowing_db
        Standard deviation of what stands between two biobots for the whole run, the same in both directions [dB].
    asymmetry_db
        Standard deviation of the difference between the two directions of a pair [dB].
    fading_db
        Standard deviation from packet to packet [dB].
    wall_db
        Loss at each wall or obstacle that the straight line passes through [dB].
    rssi_offset_db, rssi_step_db
        The strength that a receiver tells is wrong by a constant of this standard deviation, and comes in steps of this; 0: not
        rounded [dB].
    sensitivity_dbm
        At this power 1 % of 20-octet packets are lost; ``-inf``: nothing is too weak.
    burst_good_s, burst_bad_s
        Mean durations of the times in which a link works and does not [s]; both 0: it always works.
    csma
        Packets take time on one shared channel: senders wait for it to be free, and what overlaps collides.
    hidden_nodes
        Senders hear only what is strong enough for their carrier sense; without it, all hear all.
    """

    sensing: Literal["ideal", "beacon"] = "ideal"
    beacon_period_s: Annotated[float, msgspec.Meta(ge=0.1, le=60)] = 1.0
    enter_dbm: _Dbm | None = None
    exit_dbm: _Dbm | None = None
    gap_periods: Annotated[float, msgspec.Meta(ge=1.1, le=100)] = 1.15
    min_beacons: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1
    radio: str = "ideal"
    tx_power_dbm: _Dbm | None = None
    loss_1m_db: Annotated[float, msgspec.Meta(ge=0, le=200)] | None = None
    exponent: Annotated[float, msgspec.Meta(gt=0, le=10)] | None = None
    shadowing_db: _Spread | None = None
    asymmetry_db: _Spread | None = None
    fading_db: _Spread | None = None
    wall_db: Annotated[float, msgspec.Meta(ge=0, le=200)] | None = None
    rssi_offset_db: _Spread | None = None
    rssi_step_db: Annotated[float, msgspec.Meta(ge=0, le=20)] | None = None
    sensitivity_dbm: _Dbm | None = None
    burst_good_s: _Duration | None = None
    burst_bad_s: _Duration | None = None
    csma: bool | None = None
    hidden_nodes: bool | None = None


BEACON_KEYS = tuple(one.name for one in msgspec.structs.fields(RadioKeys) if one.name != "sensing")
"""What speaks of beacons and of the radio that carries them, by name."""
