"""Who may become a landmark, and who is chosen: by hop-distance maxmin on the communication graph. Pure."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from firmware_protocol.contract.records import LandmarkChoice, LandmarkCluster, Mode
from firmware_protocol.landmarks import choose_landmarks, next_landmark
from firmware_protocol.messages import Capability, WireCause, WireMode
from firmware_protocol.units import NS_PER_S, NodeId
from gateway.config import MissionTable
from gateway.nodes import Node

USUAL_SHARE = (0.1, 0.2)
"""Of landmarks among all biobots: METHOD 9, from [Dir16] IV."""


_NOT_HEARD, _NOT_TOLD = "not heard lately", "has not told lately whom it hears"
_UNABLE, _UNWILLING, _FLAT = "cannot be stimulated", "did not stand as it was told", "battery is low"
_HELD = "stands by another command"
_NEXT_STEPS = {
    _NOT_HEARD: "were not heard lately (look at them and at the radios)",
    _NOT_TOLD: "have not told lately whom they hear (it comes by itself)",
    _UNABLE: "cannot be stimulated (look at their backpacks)",
    _UNWILLING: "did not stand as they were told (they are asked again half an hour after that)",
    _FLAT: "have a low battery (change it)",
    _HELD: "stand by another command (start them)",
}
"""Why somebody is left out, of several and with what would help."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidates:
    """The communication graph, and who of it may be picked."""

    adjacency: dict[int, frozenset[int]]
    eligible: tuple[NodeId, ...]
    left_out: dict[str, tuple[NodeId, ...]]
    """Why, and who."""
    n_heard: int


def find_candidates(
    nodes: Iterable[Node], *, config: MissionTable, now_ns: int, resting: Collection[NodeId], standing: Collection[NodeId] = ()
) -> Candidates:
    """Return the graph of those heard lately, and who of them may be picked.

    Where nobody has told whom it hears, all are a graph without links: any choice is as good as another.

    Parameters
    ----------
    now_ns
        Monotonic.
    resting
        Those that may not be picked for now.
    standing
        Landmarks: they belong to the graph, and stand by our command.
    """
    left_out: dict[str, list[NodeId]] = {}
    silent_ns, stale_ns = (int(s * NS_PER_S) for s in (config.candidate_silence_s, config.neighbours_age_s))
    heard: list[Node] = []
    for node in nodes:
        if node.last_heard_ns and node.last_heard_ns >= now_ns - silent_ns:
            heard.append(node)
        else:
            left_out.setdefault(_NOT_HEARD, []).append(node.node)
    told = [node for node in heard if node.neighbours is not None and node.neighbours_ns >= now_ns - stale_ns]
    members = told or heard
    if told:
        names = {node.node for node in told}
        for node in heard:
            if node.node not in names:
                left_out.setdefault(_NOT_TOLD, []).append(node.node)
    eligible: list[NodeId] = []
    for node in members:
        if why := _why_unfit(node, config=config, resting=resting, standing=standing):
            left_out.setdefault(why, []).append(node.node)
        else:
            eligible.append(node.node)
    return Candidates(
        adjacency={int(node.node): frozenset(int(other.node) for other in (node.neighbours or ()) if told) for node in members},
        eligible=tuple(sorted(eligible)),
        left_out={why: tuple(sorted(who)) for why, who in left_out.items()},
        n_heard=len(heard),
    )


def count_wanted(config: MissionTable, *, n_known: int) -> int:
    """Return how many landmarks are wanted of so many biobots: one at least."""
    return config.n_landmarks or max(1, round(config.landmark_share * n_known))


def choose(candidates: Candidates, *, n_wanted: int, turn: int) -> LandmarkChoice:
    """Choose landmarks; fewer than wanted where there are not so many candidates."""
    count = min(n_wanted, len(candidates.eligible))
    clusters = choose_landmarks(candidates.adjacency, count=count, eligible=candidates.eligible, turn=turn)
    return LandmarkChoice(
        n_wanted=n_wanted,
        candidates=candidates.eligible,
        left_out=candidates.left_out,
        clusters=tuple(LandmarkCluster(size=len(one.members), picks=tuple(map(NodeId, one.picks)), radius=one.radius) for one in clusters),
        awaited=tuple(NodeId(pick) for one in clusters for pick in one.picks),
    )


def why_few(choice: LandmarkChoice) -> str:
    """Say why fewer can be chosen than are wanted, and what would help."""
    others = "; ".join(f"{len(who)} {_NEXT_STEPS[why]}" for why, who in sorted(choice.left_out.items()))
    more = f"; of the others {others}" if others else "; there are no others: lower mission.n_landmarks, or add biobots"
    return f"waits: {len(choice.candidates)} can be chosen, and {choice.n_wanted} landmarks are wanted{more}"


def choose_next(
    candidates: Candidates, *, standing: Collection[NodeId], excluded: Collection[NodeId], near: NodeId | None
) -> NodeId | None:
    """Return who takes a lost landmark's place, or None."""
    eligible = set(candidates.eligible) - set(excluded)
    picked = next_landmark(candidates.adjacency, standing=standing, eligible=eligible, near=near)
    return None if picked is None else NodeId(picked)


def is_walking(node: Node) -> bool:
    """Return whether a biobot walks, as far as is known from its own reports."""
    return node.mode is not None and node.mode.mode is Mode.CRW


def can_follow_walls(node: Node, *, config: MissionTable, now_ns: int) -> bool:
    """Return whether a biobot was heard lately, walks, and says that its backpack can have it follow walls; ``now_ns`` is monotonic."""
    is_heard = node.last_heard_ns and node.last_heard_ns >= now_ns - int(config.candidate_silence_s * NS_PER_S)
    return bool(is_heard and node.is_introduced and node.capabilities & Capability.FOLLOW_WALLS and is_walking(node))


def choice_facts(choice: LandmarkChoice) -> dict[str, object]:
    """Return a choice of landmarks as the audit log has it."""
    return {
        "wanted": choice.n_wanted,
        "picks": list(choice.awaited),
        "candidates": len(choice.candidates),
        "left_out": {why: len(who) for why, who in choice.left_out.items()},
        "clusters": [[one.size, len(one.picks), one.radius] for one in choice.clusters],
    }


def _why_unfit(node: Node, *, config: MissionTable, resting: Collection[NodeId], standing: Collection[NodeId]) -> str:
    """Return why a biobot may not be picked, or nothing."""
    status = node.status
    if node.is_introduced and not node.capabilities & Capability.STIMULATION:
        return _UNABLE
    if node.node in resting:
        return _UNWILLING
    if status is not None and status.battery_mv < config.min_battery_mv:
        return _FLAT
    if node.node not in standing and status is not None and status.mode is WireMode.S and status.cause is WireCause.COMMAND:
        return _HELD
    return ""
