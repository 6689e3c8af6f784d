"""Laws of the mission's state machine."""

from collections.abc import Collection
from dataclasses import dataclass, field

from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.mission_orders import MissionAction
from firmware_protocol.contract.records import MissionPhase, encode_record
from firmware_protocol.landmarks import choose_landmarks
from firmware_protocol.units import NS_PER_S, BootId, Nanoseconds, NodeId
from gateway.config import MissionTable
from gateway.issuer import RecordIssuer
from gateway.mission import MissionPlanner
from gateway.mission.candidates import Candidates, choose, choose_next
from gateway.mission.phases import POSSIBLE
from gateway.mission.planner import REST_NS
from gateway.mission.states import record_phase
from gateway.mission.steps import Choose, FollowWalls, LetGo, MakeLandmark, MissionState, MissionStep, Tell

_ALL = tuple(NodeId(node) for node in range(1, 11))
_ROW = {int(node): frozenset({node - 1, node + 1}) & frozenset(_ALL) for node in _ALL}
_WALL_NS = 1_700_000_000 * NS_PER_S


@dataclass(kw_only=True)
class Swarm:
    """Biobots in a row around a planner; those of ``deaf`` do not stand when they are told. Time is the journal's running time."""

    planner: MissionPlanner
    members: tuple[NodeId, ...] = _ALL
    links: dict[int, frozenset[int]] = field(default_factory=lambda: dict(_ROW))
    deaf: set[NodeId] = field(default_factory=set)
    now_s: float = 0.0
    waiting: list[NodeId] = field(default_factory=list)
    """Asked to stand still, and not settled yet."""
    asked: list[NodeId] = field(default_factory=list)
    let_go: list[NodeId] = field(default_factory=list)
    walls: list[FollowWalls] = field(default_factory=list)
    written: list[MissionState] = field(default_factory=list)

    @property
    def now_ns(self) -> int:
        return int(self.now_s * NS_PER_S)

    @property
    def state(self) -> MissionState:
        return self.planner.state

    def is_in(self, phase: MissionPhase) -> bool:
        return self.planner.state.phase is phase

    def candidates(self) -> Candidates:
        return Candidates(adjacency=self.links, eligible=self.members, left_out={}, n_heard=len(self.members))

    def pick(self, standing: Collection[NodeId], excluded: Collection[NodeId], near: NodeId | None) -> NodeId | None:
        return choose_next(self.candidates(), standing=standing, excluded=excluded, near=near)

    def take(self, steps: list[MissionStep]) -> None:
        for step in steps:
            match step:
                case Tell(state=state):
                    self.written.append(state)
                case Choose(turn=turn):
                    config = self.planner.config
                    wanted = config.n_landmarks or max(1, round(config.landmark_share * len(self.members)))
                    self.take(self.planner.take_choice(choose(self.candidates(), n_wanted=wanted, turn=turn), now_ns=self.now_ns))
                case MakeLandmark(node=node):
                    self.waiting.append(node)
                    self.asked.append(node)
                case LetGo(node=node):
                    self.let_go.append(node)
                case FollowWalls():
                    self.walls.append(step)

    def tick(self, *, after_s: float = 0.0, is_graph_known: bool = True, n_known: int | None = None) -> None:
        self.now_s += after_s
        known = len(self.members) if n_known is None else n_known
        steps = self.planner.tick(
            now_ns=self.now_ns, n_known=known, is_graph_known=is_graph_known, pick=self.pick, followers=self.followers
        )
        self.take(steps)

    def followers(self) -> list[NodeId]:
        return [node for node in self.members if node not in self.state.landmarks | self.state.awaited]

    def told(self) -> list[tuple[NodeId, bool]]:
        """Return who was told to follow walls (or that it is over) since this was asked last, and let them have obeyed."""
        told, self.walls = self.walls, []
        for step in told:
            if step.is_over:
                self.take(self.planner.leave_walls(step.node, decided_ns=step.decided_ns))
        return [(step.node, step.is_over) for step in told]

    def settle(self, node: NodeId, *, is_standing: bool) -> None:
        self.take(self.planner.settle(node, is_standing=is_standing, reason="", now_ns=self.now_ns, wall_ns=_WALL_NS))

    def settle_all(self) -> None:
        while self.waiting:
            node = self.waiting.pop()
            self.settle(node, is_standing=node not in self.deaf)
            self.tick()

    def lose(self, node: NodeId, *, is_let_go: bool = False) -> None:
        steps = self.planner.lose(node, reason="it is gone", is_let_go=is_let_go, now_ns=self.now_ns, wall_ns=_WALL_NS)
        self.take(steps)

    def order(self, action: MissionAction) -> str | None:
        refusal, steps = self.planner.order(action, operator="ann", order_id=f"o{self.now_s}", now_ns=self.now_ns)
        self.take(steps)
        return refusal

    def restart(self) -> "Swarm":
        """Kill the process: what was written is all there is. What the disk has is what was told."""
        state = self.written[-1] if self.written else MissionState()
        planner = MissionPlanner(config=self.planner.config)
        again = Swarm(planner=planner, members=self.members, links=self.links, deaf=self.deaf, now_s=self.now_s, written=self.written)
        again.take(planner.resume(state, now_ns=self.now_ns))
        return again


def a_swarm(**config: object) -> Swarm:
    return Swarm(planner=MissionPlanner(config=MissionTable(**{"is_enabled": True, **config})))  # type: ignore[arg-type]


def exploring(**config: object) -> Swarm:
    """After a whole selection, in which all obey."""
    swarm = a_swarm(**config)
    swarm.tick()
    swarm.tick(after_s=swarm.planner.config.dispersion_s)
    swarm.tick()
    swarm.settle_all()
    assert swarm.is_in(MissionPhase.EXPLORATION)
    return swarm


def test_nothing_happens_before_a_biobot_is_heard() -> None:
    swarm = a_swarm()
    swarm.tick(after_s=1000, n_known=0)
    assert swarm.is_in(MissionPhase.IDLE)
    assert not swarm.written


def test_without_being_enabled_it_waits_for_the_order_to_start() -> None:
    swarm = a_swarm(is_enabled=False)
    swarm.tick(after_s=1000)
    assert swarm.is_in(MissionPhase.IDLE)
    assert swarm.order(MissionAction.START) is None
    assert swarm.is_in(MissionPhase.DISPERSION)
    assert (swarm.state.operator, swarm.state.round) == ("ann", 1)


def test_the_landmarks_are_those_of_the_rule() -> None:
    swarm = exploring(n_landmarks=4)
    (row,) = choose_landmarks(_ROW, count=4, eligible=_ALL)
    assert swarm.asked == list(row.picks)
    assert swarm.state.landmarks == set(row.picks)


@given(st.sets(st.sampled_from(_ALL)))
def test_exploration_begins_when_as_many_landmarks_stand_as_are_wanted_and_else_it_is_told_why_not(deaf: set[NodeId]) -> None:
    swarm = a_swarm(n_landmarks=3, dispersion_s=0)
    swarm.deaf = deaf
    swarm.tick()
    swarm.tick()
    swarm.tick()
    swarm.settle_all()
    n_standing = len(set(_ALL) - deaf)
    assert swarm.is_in(MissionPhase.EXPLORATION if n_standing >= 3 else MissionPhase.LANDMARK_SELECTION)
    if n_standing < 3:
        assert f"{n_standing} landmarks stand; not reached: " in swarm.written[-1].reason
        assert "3 are wanted: " in swarm.written[-1].reason
        assert swarm.order(MissionAction.REDISPERSE) is None
        assert not swarm.planner.resting, "whoever orders that has looked at them"
        return
    assert len(swarm.asked) == len(set(swarm.asked)), "nobody is asked twice"
    assert swarm.state.landmarks == set(swarm.asked) - deaf
    assert len(swarm.state.landmarks) == min(3, len(set(_ALL) - deaf))


def test_selection_waits_for_neighbour_reports_but_not_for_ever() -> None:
    swarm = a_swarm(selection_timeout_s=30, n_landmarks=2)
    swarm.tick()
    swarm.tick(after_s=60, is_graph_known=False)
    swarm.tick(after_s=20, is_graph_known=False)
    assert not swarm.asked
    swarm.tick(after_s=10, is_graph_known=False)
    assert len(swarm.asked) == 2


def test_a_choice_without_candidates_is_made_again_later_and_nobody_is_asked() -> None:
    swarm = a_swarm(dispersion_s=0, n_landmarks=2)
    members, swarm.members = swarm.members, ()
    for _ in range(3):
        swarm.tick(n_known=10)
    assert swarm.is_in(MissionPhase.LANDMARK_SELECTION)
    assert "0 can be chosen, and 2 landmarks are wanted" in swarm.written[-1].reason
    swarm.members = members[:1]
    swarm.tick(after_s=6)
    assert not swarm.asked, "one of two is no choice"
    assert "1 can be chosen, and 2 landmarks are wanted" in swarm.written[-1].reason
    n_written = len(swarm.written)
    swarm.tick(after_s=6)
    assert len(swarm.written) == n_written, "it is told once"
    swarm.members = members
    swarm.tick(after_s=6)
    assert len(swarm.asked) == 2


def test_a_selection_in_which_nobody_answers_waits_and_tells_why_instead_of_stopping_everyone() -> None:
    """With 3 landmarks wanted among 60, ten failures end the replacing; at most two more were under way by then."""
    swarm = a_swarm(n_landmarks=3, dispersion_s=0)
    swarm.members = tuple(NodeId(node) for node in range(1, 61))
    swarm.links = {int(node): frozenset({node - 1, node + 1}) & frozenset(swarm.members) for node in swarm.members}
    swarm.deaf = set(swarm.members)
    for _ in range(3):
        swarm.tick()
    swarm.settle_all()
    assert 10 <= len(swarm.asked) <= 12
    assert swarm.is_in(MissionPhase.LANDMARK_SELECTION)
    assert "so many failed that none is asked any more" in swarm.written[-1].reason
    for node in swarm.asked[:3]:
        swarm.take(swarm.planner.stands_after_all(node, now_ns=swarm.now_ns))
    swarm.tick()
    assert swarm.is_in(MissionPhase.EXPLORATION), "they stand after all"


def test_a_lost_landmark_is_replaced_where_it_stood_and_not_by_itself() -> None:
    """Landmarks 1, 5 and 9 or 10 of a row of ten: with one end gone, the candidate furthest from the others is at that end."""
    swarm = exploring(n_landmarks=3)
    lost = max(swarm.state.landmarks)
    swarm.lose(lost)
    swarm.tick()
    (replacement,) = swarm.waiting
    assert replacement != lost
    rest = swarm.state.landmarks
    gap = {node: min(abs(node - other) for other in rest) for node in set(_ALL) - rest - {lost}}
    assert gap[replacement] == max(gap.values())
    swarm.settle_all()
    assert len(swarm.state.landmarks) == 3
    (change,) = swarm.state.changes
    assert (change.node, change.replacement, change.reason) == (lost, replacement, "it is gone")
    assert swarm.written[-1] == swarm.state, "what stands is on disk"


def test_who_was_lost_is_not_chosen_again_for_a_while() -> None:
    swarm = exploring(n_landmarks=3, redisperse_every_s=100)
    lost = min(swarm.state.landmarks)
    swarm.lose(lost, is_let_go=True)
    assert swarm.let_go == [lost]
    assert lost in swarm.planner.resting
    assert swarm.planner.resting[lost] - swarm.now_ns == REST_NS


def test_a_landmark_that_says_it_walks_is_stopped_once_more_and_then_replaced() -> None:
    swarm = exploring(n_landmarks=3)
    node = min(swarm.state.landmarks)
    told = {"reason": "it walks", "now_ns": swarm.now_ns, "wall_ns": _WALL_NS}
    swarm.take(swarm.planner.is_walking(node, **told))  # type: ignore[arg-type]
    assert swarm.waiting.pop() == node
    swarm.settle(node, is_standing=True)
    assert node in swarm.state.landmarks
    swarm.take(swarm.planner.is_walking(node, **told))  # type: ignore[arg-type]
    assert node not in swarm.state.landmarks
    assert swarm.let_go == [node]


def test_another_round_lets_the_landmarks_go_and_takes_another_first_pick() -> None:
    swarm = exploring(n_landmarks=2, redisperse_every_s=100, exploration_s=250)
    first = swarm.asked[:]
    swarm.tick(after_s=100)
    assert swarm.is_in(MissionPhase.DISPERSION)
    assert set(swarm.let_go) == set(first)
    for node in first:
        swarm.planner.released(node)
    swarm.tick(after_s=60)
    swarm.tick()
    assert swarm.asked[2:3] != first[:1]
    swarm.settle_all()
    assert swarm.state.round == 2
    swarm.tick(after_s=100)
    swarm.tick(after_s=60)
    swarm.tick()
    swarm.settle_all()
    assert swarm.is_in(MissionPhase.EXPLORATION)
    swarm.tick(after_s=49)
    assert swarm.is_in(MissionPhase.EXPLORATION)
    swarm.tick(after_s=2)
    assert swarm.is_in(MissionPhase.DONE), "exploration counts over all rounds: 100 + 100 + 50"


def test_a_pause_stops_the_time_of_a_phase() -> None:
    swarm = a_swarm(dispersion_s=60)
    swarm.tick()
    swarm.tick(after_s=40)
    swarm.order(MissionAction.PAUSE)
    swarm.tick(after_s=500)
    assert swarm.planner.remaining_ns(swarm.now_ns) == 20 * NS_PER_S
    swarm = swarm.restart()
    swarm.tick(after_s=500)
    assert swarm.order(MissionAction.RESUME) is None
    assert swarm.state.is_continued
    swarm.tick(after_s=19)
    assert swarm.is_in(MissionPhase.DISPERSION)
    swarm.tick(after_s=1)
    assert swarm.is_in(MissionPhase.LANDMARK_SELECTION)


def test_after_a_stop_of_all_those_who_walked_walk_again_when_it_is_resumed_and_the_landmarks_stay() -> None:
    swarm = exploring(n_landmarks=3)
    landmarks = swarm.state.landmarks
    swarm.take(swarm.planner.stop_all(operator="ann", walking=set(_ALL) - landmarks, now_ns=swarm.now_ns))
    assert (swarm.state.phase, swarm.state.interrupted) == (MissionPhase.PAUSED, MissionPhase.EXPLORATION)
    assert not swarm.let_go
    swarm = swarm.restart()
    assert not swarm.let_go
    swarm.order(MissionAction.RESUME)
    assert set(swarm.let_go) == set(_ALL) - landmarks
    assert swarm.state.landmarks == landmarks


def test_a_mission_that_is_done_stays_done_over_a_restart_until_it_is_ordered_to_start() -> None:
    swarm = exploring(n_landmarks=3)
    landmarks = swarm.state.landmarks
    swarm.order(MissionAction.FINISH)
    swarm = swarm.restart()
    swarm.tick(after_s=1000)
    assert swarm.is_in(MissionPhase.DONE)
    assert swarm.state.landmarks == landmarks, "they stay where they are"
    swarm.order(MissionAction.START)
    assert swarm.is_in(MissionPhase.DISPERSION)
    assert set(swarm.let_go) == landmarks
    assert swarm.state.round == 1


def test_a_killed_selection_goes_on_with_the_same_choice() -> None:
    swarm = a_swarm(n_landmarks=4, dispersion_s=0)
    for _ in range(3):
        swarm.tick()
    chosen = swarm.asked[:]
    swarm.settle(swarm.waiting.pop(), is_standing=True)
    swarm = swarm.restart()
    swarm.links = dict.fromkeys(map(int, _ALL), frozenset())  # another graph by now: nothing is chosen anew
    swarm.tick()
    swarm.settle_all()
    assert swarm.state.landmarks == set(chosen)
    assert swarm.is_in(MissionPhase.EXPLORATION)


def test_one_that_did_not_answer_but_stands_is_a_landmark_where_one_is_wanted_and_else_is_let_go() -> None:
    swarm = a_swarm(n_landmarks=3, dispersion_s=0)
    for _ in range(3):
        swarm.tick()
    late = swarm.waiting[0]
    swarm.deaf = {late}
    swarm.settle_all()
    assert len(swarm.state.landmarks) == 3
    swarm.take(swarm.planner.stands_after_all(late, now_ns=swarm.now_ns))
    swarm.take(swarm.planner.stands_after_all(late, now_ns=swarm.now_ns))
    assert swarm.let_go == [late], "once"
    scarce = a_swarm(n_landmarks=10, dispersion_s=0)
    for _ in range(3):
        scarce.tick()
    scarce.deaf = {NodeId(4)}
    scarce.settle_all()
    scarce.take(scarce.planner.stands_after_all(NodeId(4), now_ns=scarce.now_ns))
    assert scarce.state.landmarks == set(_ALL)
    assert not scarce.let_go


_events = st.one_of(
    st.tuples(st.just("tick"), st.sampled_from([0.0, 0.1, 5.0, 61.0])),
    st.tuples(st.just("order"), st.sampled_from(MissionAction)),
    st.tuples(st.just("stop_all"), st.none()),
    st.tuples(st.just("settle"), st.booleans()),
    st.tuples(st.just("lose"), st.booleans()),
    st.tuples(st.just("walks"), st.integers(0, 9)),
    st.tuples(st.just("released"), st.integers(0, 9)),
    st.tuples(st.just("stands"), st.integers(0, 9)),
    st.tuples(st.just("restart"), st.none()),
)


def _apply(swarm: Swarm, kind: str, value: object) -> Swarm:
    planner = swarm.planner
    match kind, value:
        case "tick", float(after_s):
            swarm.tick(after_s=after_s)
        case "order", MissionAction() as action:
            before, possible = swarm.state, planner.possible()
            refusal = swarm.order(action)
            assert (refusal is None) == (action in possible)
            assert refusal is None or (swarm.state == before and "possible is" in refusal)
        case "stop_all", _:
            standing = swarm.state.landmarks | swarm.state.awaited
            swarm.take(planner.stop_all(operator="ann", walking=set(_ALL) - standing, now_ns=swarm.now_ns))
            assert swarm.state.phase in {MissionPhase.IDLE, MissionPhase.PAUSED, MissionPhase.DONE}
        case "settle", bool(is_standing) if swarm.waiting:
            swarm.settle(swarm.waiting.pop(), is_standing=is_standing)
        case "lose", bool(is_let_go) if swarm.state.landmarks:
            swarm.lose(min(swarm.state.landmarks), is_let_go=is_let_go)
        case "walks", int(index):
            steps = planner.is_walking(_ALL[index], reason="it walks", now_ns=swarm.now_ns, wall_ns=_WALL_NS)
            swarm.take(steps)
        case "released", int(index):
            planner.released(_ALL[index])
            swarm.take(planner.leave_walls(_ALL[index]))
        case "stands", int(index):
            swarm.take(planner.stands_after_all(_ALL[index], now_ns=swarm.now_ns))
        case "restart", _:
            swarm.tick()
            phase, remaining_ns = swarm.state.phase, planner.remaining_ns(swarm.now_ns)
            swarm = swarm.restart()
            assert (swarm.state.phase, swarm.planner.remaining_ns(swarm.now_ns)) == (phase, remaining_ns)
    return swarm


@settings(max_examples=150)
@given(is_enabled=st.booleans(), events=st.lists(_events, max_size=60))
def test_from_any_state_any_event_leads_to_a_known_state(is_enabled: bool, events: list[tuple[str, object]]) -> None:
    """And whoever is commanded is so by a state that is on disk, and by one that commands."""
    swarm = a_swarm(
        is_enabled=is_enabled, n_landmarks=3, exploration_s=300, redisperse_every_s=120, wall_following_every_s=40, wall_following_s=15
    )
    for kind, value in events:
        n_asked, n_let_go, n_walls = len(swarm.asked), len(swarm.let_go), len(swarm.walls)
        before = swarm
        swarm = _apply(swarm, kind, value)
        if swarm is not before:
            n_asked = n_let_go = n_walls = 0
        state = swarm.state
        assert state.phase in POSSIBLE
        assert (state.interrupted is not None) == (state.phase is MissionPhase.PAUSED)
        assert not state.landmarks & state.awaited
        assert state.elapsed_ns(swarm.now_ns) >= 0
        commanded = swarm.asked[n_asked:], swarm.let_go[n_let_go:], swarm.walls[n_walls:]
        if any(commanded):
            assert state.phase not in {MissionPhase.PAUSED, MissionPhase.IDLE}
            on_disk = swarm.written[-1]
            assert set(commanded[0]) <= on_disk.awaited | on_disk.landmarks
            assert set(commanded[1]) <= on_disk.releasing.keys()
            assert all(on_disk.following[step.node] == step.decided_ns for step in commanded[2])


WALLS = {"n_landmarks": 2, "wall_following_every_s": 100, "wall_following_s": 30}


def test_walls_are_followed_every_so_often_for_so_long_by_those_who_walk() -> None:
    swarm = exploring(**WALLS)
    walking = swarm.followers()
    for number in (1, 2):
        swarm.tick(after_s=99 if number == 1 else 69)
        assert swarm.told() == []
        swarm.tick(after_s=1)
        assert swarm.told() == [(node, False) for node in walking]
        assert swarm.state.reason.endswith(f"stand; wall phase {number} has begun: 8 biobots are told to follow walls")
        swarm.tick(after_s=29)
        assert swarm.told() == []
        swarm.tick(after_s=1)
        assert swarm.told() == [(node, True) for node in walking]
        assert swarm.state.reason.endswith(f"landmarks stand; wall phase {number} is over")
        assert not swarm.state.following


def test_without_the_option_nobody_follows_walls_and_nothing_is_written_of_it() -> None:
    swarm = exploring(n_landmarks=2)
    n_written = len(swarm.written)
    for _ in range(50):
        swarm.tick(after_s=50)
    assert (swarm.walls, len(swarm.written)) == ([], n_written)
    record = record_phase(
        swarm.state, issuer=RecordIssuer(gateway="g", journal="j", boot=BootId(1), wall_anchor_ns=Nanoseconds(0)), now_ns=1
    )
    assert b"walls" not in encode_record(record)


def test_a_wall_phase_outlives_the_process_and_ends_at_its_time() -> None:
    """Killed in it, the same biobots are told by the same names, and at its end by one name, however often it is killed."""
    swarm = exploring(**WALLS)
    swarm.tick(after_s=110)
    first = list(swarm.walls)
    swarm = swarm.restart()
    assert swarm.walls == first
    swarm.tick(after_s=10)
    assert swarm.walls == first
    swarm = swarm.restart()
    swarm.walls.clear()
    swarm.tick(after_s=20)
    last = list(swarm.walls)
    assert {(step.node, step.decided_ns) for step in last} == {(step.node, step.decided_ns) for step in first}
    swarm = swarm.restart()
    swarm.tick()
    assert swarm.walls == last
    swarm.told()
    swarm.tick()
    assert swarm.restart().walls == []


def test_a_paused_wall_phase_tells_nobody_anything_and_goes_on_for_what_was_left_of_it() -> None:
    swarm = exploring(**WALLS)
    swarm.tick(after_s=110)
    told = swarm.told()
    assert swarm.order(MissionAction.PAUSE) is None
    swarm.tick(after_s=500)
    assert swarm.told() == []
    assert swarm.order(MissionAction.RESUME) is None
    assert swarm.told() == told, "by the names that they had"
    swarm.tick(after_s=19)
    assert swarm.told() == []
    swarm.tick(after_s=1)
    assert {is_over for _, is_over in swarm.told()} == {True}


def test_who_is_commanded_by_somebody_else_or_stands_is_told_nothing_more_of_walls() -> None:
    swarm = exploring(**WALLS)
    swarm.tick(after_s=110)
    steps = {step.node: step for step in swarm.walls}
    steered, asked, *_ = steps
    swarm.take(swarm.planner.leave_walls(steered))
    swarm.lose(min(swarm.state.landmarks))
    while swarm.state.awaited != {asked}:  # until that one is to take its place
        swarm.tick(after_s=1)
        asked = next(iter(swarm.state.awaited), asked)
    assert not swarm.planner.follows(steps[steered], now_ns=swarm.now_ns)
    assert not swarm.planner.follows(steps[asked], now_ns=swarm.now_ns)
    free = next(node for node in steps if node not in {steered, asked})
    assert swarm.planner.follows(steps[free], now_ns=swarm.now_ns)
    swarm.walls.clear()
    swarm.tick(after_s=30)
    assert steered not in {step.node for step in swarm.walls}
    assert not swarm.planner.follows(steps[free], now_ns=swarm.now_ns), "its time is over"


def test_a_stop_of_all_ends_the_following_of_walls() -> None:
    swarm = exploring(**WALLS)
    swarm.tick(after_s=110)
    swarm.take(swarm.planner.stop_all(operator="ann", walking=swarm.followers(), now_ns=swarm.now_ns))
    swarm.walls.clear()
    assert swarm.order(MissionAction.RESUME) is None
    swarm.tick(after_s=50)
    assert swarm.walls == []
    assert set(swarm.let_go) == set(swarm.followers())
