"""What beacon sensing adds to the files of a whole run: what was observed, and how true it is."""

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

from simulator.arenas.arena import Arena
from simulator.errors import ParameterError
from simulator.radios.fidelity import Encounter, compare
from simulator.radios.paths import Paths
from simulator.radios.radio import choose_radio
from simulator.radios.radio_keys import RadioKeys
from simulator.radios.sensing import AirReport, Observation, SensingConfig, sense
from simulator.setting import Setting
from simulator.world import World

HEADER = ("node", "peer", "t_start_s", "t_end_s", "mean_rssi_dbm", "n_beacons")

_NS_PER_S = 1_000_000_000
# About 2 us and 100 bytes each (2026-11-27, a busy core): a minute or two, and some gigabytes.
_MAX_HEARD = 40_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class SensedRun:
    """Results of beacon sensing from ``zero_s`` on.

    Parameters
    ----------
    encounters
        What a gateway would put together, in the world's time.
    files
        Further files by name.
    description
        For ``run.json``.
    """

    encounters: tuple[Encounter, ...]
    files: dict[str, bytes]
    description: dict[str, object]


def sensing_config(keys: RadioKeys, setting: Setting, *, loss: float | None = None) -> SensingConfig:
    """Choose how backpacks sense each other.

    Raises
    ------
    ScenarioError, ParameterError
        No radio preset has the name given, or a value is out of range.
    """
    config = SensingConfig(
        seed=setting.seed,
        detection=setting.ranges.detection,
        communication=setting.ranges.communication,
        period_s=keys.beacon_period_s,
        enter_dbm=keys.enter_dbm,
        exit_dbm=keys.exit_dbm,
        gap_periods=keys.gap_periods,
        min_beacons=keys.min_beacons,
        radio=choose_radio(keys, loss=loss),
    )
    config.proximity(per_s=_NS_PER_S)
    return config


def check_work(config: SensingConfig, setting: Setting) -> None:
    """Refuse, before anybody walks, what would be sensed for hours or fill the memory.

    Raises
    ------
    ParameterError
        All neighbours within the communication radius together hear too many beacons.
    """
    near = min(1.0, math.pi * setting.ranges.communication**2 / setting.arena.area)
    heard = near * setting.biobots**2 * (setting.dispersion_s + setting.duration_s) / config.period_s
    if heard > _MAX_HEARD:
        raise ParameterError(
            name="number of beacons to be heard",
            got=round(heard),
            wanted=f"at most {_MAX_HEARD}: take fewer biobots, less time, a longer beacon_period_s or --sensing ideal",
        )


def sense_run(
    world: World,
    *,
    arena: Arena,
    config: SensingConfig,
    zero_s: float,
    true: Sequence[Encounter],
    radio: str,
    off_s: Mapping[int, float] | None = None,
    progress: Callable[[float], None] | None = None,
) -> SensedRun:
    """Sense a finished run.

    Parameters
    ----------
    arena
        Whose walls attenuate.
    zero_s
        What ended before is left out, and what was going on starts then [s of the world].
    true
        The exact encounters, likewise.
    radio
        Name of the radio's preset.
    off_s
        When backpacks fell silent [s of the world], by identity; None: never.
    progress
        Called now and then with the instant up to which beacons were looked at [s of the world].
    """
    zero_ns = round(zero_s * _NS_PER_S)
    sensed = sense(
        Paths(world.legs(), n=len(world.ids)),
        ids=world.ids,
        arena=arena,
        until_s=world.now_s,
        config=config,
        off_s=off_s,
        progress=progress,
    )
    encounters = tuple((max(start, zero_s), end, id1, id2) for start, end, id1, id2 in sensed.encounters if end > zero_s)
    observations = [
        replace(one, start_ns=max(one.start_ns, zero_ns) - zero_ns, end_ns=one.end_ns - zero_ns)
        for one in sensed.observations
        if one.end_ns > zero_ns
    ]
    return SensedRun(
        encounters=encounters,
        files={"observations.csv": _to_csv(observations)},
        description=_describe(sensed.air, config, radio=radio) | {"observations": len(observations), "fidelity": compare(encounters, true)},
    )


def _describe(air: AirReport, config: SensingConfig, *, radio: str) -> dict[str, object]:
    proximity = config.proximity(per_s=_NS_PER_S)
    parameters = {name: None if value == float("-inf") else value for name, value in asdict(config.radio).items()}
    return {
        "beacon_period_s": config.period_s,
        "enter_dbm": round(proximity.enter_dbm, 3),
        "exit_dbm": round(proximity.exit_dbm, 3),
        "gap_periods": config.gap_periods,
        "min_beacons": config.min_beacons,
        "clock_drift_ppm": config.drift_ppm,
        "unit_of_length_counts_as": "1 m",
        "radio": {"preset": radio, **parameters},
        "air": {
            "beacons_sent": air.sent,
            "beacons_not_sent": air.not_sent,
            "airtime_load": round(air.load, 6),
            "at_neighbours": air.fates,
        },
    }


def _to_csv(observations: Sequence[Observation]) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADER)
    for one in observations:
        times = (f"{one.start_ns / 1e9:.9f}", f"{one.end_ns / 1e9:.9f}")
        writer.writerow((one.node, one.peer, *times, f"{one.mean_rssi_dbm:.1f}", one.n_beacons))
    return text.getvalue().encode()
