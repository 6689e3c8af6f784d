"""Histories of the gate as Hypothesis draws and shrinks them: a rule for everything that can happen to it."""

import dataclasses
import tempfile
from collections.abc import Callable
from pathlib import Path

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from firmware_protocol.contract.commands import PulseRequest, StimulationAction
from studies.gate_histories import sites
from studies.gate_histories.disk import MemoryRows, StoredRows
from studies.gate_histories.laws import violations
from studies.gate_histories.story import tell
from studies.gate_histories.world import Order, Site, World

_STORED = range(40, 43)
"""Of 0 to 99: the histories that have their journal in a file; Hypothesis likes the ends of a range."""

_NOBODY = 77
_radios = st.integers(0, 2)
_numbers = st.integers(0, 2)
_moves = st.integers(0, sites.N_MOVES - 1).map(sites.move)  # one draw for all of it: Hypothesis' draws are half of the work
_orders = st.integers(0, sites.N_ORDERS - 1).map(sites.order)
_series = st.integers(0, sites.N_SERIES - 1).map(sites.series)
_fates = st.lists(st.integers(0, sites.N_FATES - 1), min_size=1, max_size=3)


class GateHistory(RuleBasedStateMachine):
    """One history; its laws are judged when it is over. ``report`` gets the world and what was broken."""

    def __init__(self, report: Callable[[World, list[str]], None] | None = None) -> None:
        super().__init__()
        self._report = report
        self._directory: tempfile.TemporaryDirectory[str] | None = None
        self._world: World | None = None

    @initialize(site=st.sampled_from(sites.SITES), stored=st.integers(0, 99), announced=st.booleans())
    def begin(self, *, site: Site, stored: int, announced: bool) -> None:
        """Start the gateway, and let the biobots be heard."""
        if stored in _STORED:
            self._directory = tempfile.TemporaryDirectory(prefix="gate-history-")
        rows = MemoryRows() if self._directory is None else StoredRows(Path(self._directory.name) / "journal.sqlite")
        self._world = World(site, rows=rows)
        self._world.wait(50)
        for node in self._world.biobots if announced else ():
            self._world.hear(node, announces=True)

    @rule(move=_moves)
    def move(self, *, move: sites.Move) -> None:
        """Move a biobot."""
        self.world.order(Order(action=move.action, node=self._node(move.number)))
        self.world.wait(move.wait_ms)

    @rule(number=_numbers, wait=st.sampled_from(sites.WAITS_MS), hold_ms=st.sampled_from(sites.HOLDS_MS))
    def stop(self, *, number: int, wait: int, hold_ms: int) -> None:
        """Stop a biobot."""
        self.world.order(Order(action=StimulationAction.STOP, node=self._node(number), hold_ms=hold_ms))
        self.world.wait(wait)

    @rule(number=_numbers, wait=st.sampled_from(sites.WAITS_MS), pulse=st.sampled_from(sites.PULSES[:2]))
    def walk_along_walls(self, *, number: int, wait: int, pulse: PulseRequest | None) -> None:
        """Send a biobot along walls, with a train or without."""
        self.world.order(Order(action=StimulationAction.FOLLOW_WALLS, node=self._node(number), pulse=pulse))
        self.world.wait(wait)

    @rule(wait=st.sampled_from(sites.WAITS_MS))
    def stop_all(self, *, wait: int) -> None:
        """Stop all."""
        self.world.order(Order(action=StimulationAction.STOP_ALL, node=0))
        self.world.wait(wait)

    @rule(order=_orders)
    def order(self, *, order: Order) -> None:
        """Give a command with everything to it; number 4 is nobody's."""
        self.world.order(dataclasses.replace(order, node=_NOBODY if order.node > 3 else self._node(order.node - 1)))

    @rule(series=_series)
    def hammer(self, *, series: sites.Series) -> None:
        """Move a biobot again and again, with a stop between; it is refused when it has had enough."""
        for at in range(series.n):
            is_stop = series.stop_at and at % 6 == series.stop_at - 1
            action = StimulationAction.STOP if is_stop else StimulationAction.TURN_LEFT
            self.world.order(Order(action=action, node=self._node(series.number)))
            self.world.wait(series.gap_ms)

    @rule(wait=st.sampled_from(sites.WAITS_MS))
    def recover(self, *, wait: int) -> None:
        """Let all that fails work again, and everybody be heard."""
        self.world.recover()
        self.world.wait(wait)

    @rule(back=st.integers(0, 5), action=st.sampled_from((None, None, None, *sites.ACTIONS)))
    def repeat(self, *, back: int, action: StimulationAction | None) -> None:
        """Give an earlier command again, or another one under its id."""
        self.world.repeat(back, action=action)

    @rule(ms=st.sampled_from(sites.WAITS_MS))
    def wait(self, *, ms: int) -> None:
        """Let time pass."""
        self.world.wait(ms)

    @rule(ms=st.sampled_from(sites.JUMPS_MS))
    def jump_wall_clock(self, *, ms: int) -> None:
        """Set the gateway's wall clock."""
        self.world.jump_wall_clock(ms)

    @rule(down_ms=st.sampled_from(sites.DOWNS_MS), is_reboot=st.booleans(), wait=st.sampled_from((100, 0, 1_000)))
    def restart_gateway(self, *, down_ms: int, is_reboot: bool, wait: int) -> None:
        """Kill the gateway, and start it again."""
        self.world.restart_gateway(down_ms=down_ms, is_reboot=is_reboot)
        self.world.wait(wait)

    @rule(number=_numbers)
    def restart_backpack(self, *, number: int) -> None:
        """Let a backpack lose its memory."""
        self.world.restart_backpack(self._node(number))

    @rule(radio=_radios, fates=_fates)
    def trouble(self, *, radio: int, fates: list[int]) -> None:
        """Let a radio lose, delay, repeat or overtake its next frames and answers."""
        self.world.set_fates(radio % len(self.world.air.radios), tuple(sites.fate(one) for one in fates))

    @rule(radio=_radios, is_up=st.booleans())
    def port(self, *, radio: int, is_up: bool) -> None:
        """Let a radio's port be lost or come back."""
        self.world.set_radio(radio % len(self.world.air.radios), is_up=is_up)

    @rule(is_full=st.booleans(), commit_ms=st.sampled_from(sites.COMMITS_MS))
    def disk(self, *, is_full: bool, commit_ms: int) -> None:
        """Let the disk be full, slow or well."""
        self.world.set_disk(is_full=is_full, commit_ms=commit_ms)

    @rule(is_there=st.booleans())
    def commander(self, *, is_there: bool) -> None:
        """Let a commander come or go."""
        self.world.set_commander(sites.COMMANDERS[1], is_there=is_there)

    @rule(number=_numbers, announces=st.booleans())
    def hear(self, *, number: int, announces: bool) -> None:
        """Let a biobot be heard, and announce its limits."""
        self.world.hear(self._node(number), announces=announces)

    @property
    def world(self) -> World:
        """The history as it is now."""
        assert self._world is not None
        return self._world

    def teardown(self) -> None:
        """End the history, and judge it."""
        try:
            if self._world is None:
                return
            self._world.close()
            found = violations(self._world)
            if self._report is not None:
                self._report(self._world, found)
            assert not found, "\n".join([*found, tell(self._world)])
        finally:
            if self._directory is not None:
                self._directory.cleanup()

    def _node(self, number: int) -> int:
        return number % len(self.world.biobots) + 1
