"""What the endpoints look at; they own none of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mapper.access import Access
from mapper.alert_watch import AlertWatch
from mapper.bus import Bus
from mapper.changes import Changes
from mapper.commands import CommandDesk
from mapper.current_map import CurrentMap
from mapper.emergency_stop import EmergencyStop
from mapper.encounter_export import Exports
from mapper.fleet import Fleet
from mapper.jobs import JobDesk
from mapper.map_history import MapHistory
from mapper.mission_orders import MissionDesk
from mapper.pin_board import PinBoard
from mapper.stimulation_accounts import StimulationAccounts
from mapper.store_thread import StoreThread
from mapper.types import KernelsKind


@dataclass(frozen=True, slots=True, kw_only=True)
class Engines:
    """What computes the maps; ``persistence`` is None where no library for it is installed."""

    kernels: KernelsKind
    persistence: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Services:
    """The parts of the mapper that answer requests. ``faults`` and ``counters`` are asked for anew each time."""

    bus: Bus
    records: StoreThread
    fleet: Fleet
    current_map: CurrentMap
    history: MapHistory
    alerts: AlertWatch
    commands: CommandDesk
    emergency_stop: EmergencyStop
    mission: MissionDesk
    accounts: StimulationAccounts
    access: Access
    pins: PinBoard
    jobs: JobDesk
    exports: Exports
    changes: Changes
    is_connected: Callable[[], bool]
    counters: Callable[[], Mapping[str, int]]
    faults: Callable[[], list[str]]
    engines: Engines
