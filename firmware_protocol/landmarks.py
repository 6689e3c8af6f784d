"""Who stands still: landmarks picked by hop-distance maxmin on the communication graph.

The rule of [Dir16] IV, "Exploration and Event Collection": from a connected graph, landmarks are picked one by one, each as many
hops away from those before it as can be; of a graph in several clusters, each cluster gives a share in proportion to its size.

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
"""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush

from firmware_protocol.errors import LandmarkCountError

MAX_STARTS = 64
"""First picks that are tried in a cluster: more of them made nothing better (``python -m studies.landmark_choice``)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterChoice:
    """Landmarks of one cluster, in the order of choice."""

    members: tuple[int, ...]
    """All that the cluster has, those that could not be picked too, by id."""
    picks: tuple[int, ...]
    radius: int
    """No member is more hops away from a pick; 0 where there is none."""


def select_landmarks(adjacency: Mapping[int, Collection[int]], *, count: int) -> tuple[int, ...]:
    """Pick landmarks by hop-distance maxmin, cluster by cluster.

    Parameters
    ----------
    adjacency
        Each candidate's id, and whom it hears. One side's word is enough for a link; itself, and ids that are no
        candidates, are left aside.
    count
        How many to pick, 0 to the number of candidates.

    Returns
    -------
    tuple of int
        Their ids: clusters by their lowest id, and in each the order of choice.

    Raises
    ------
    LandmarkCountError
        ``count`` is negative or exceeds the number of candidates.

    Notes
    -----
    In each cluster the first pick is the lowest id, and the next always the one with most hops to the nearest pick; ties go
    to the lowest id. Shares are by largest remainder, ties to the larger cluster, then to the one with the lowest id. Every
    step is determined, where [Dir16] draws lots among clusters: equal reports give equal landmarks. [Dir16] IV.
    """
    if not 0 <= count <= len(adjacency):
        raise LandmarkCountError(count=count, candidates=len(adjacency))
    links = _symmetric_links(adjacency)
    clusters = _find_clusters(links)
    sizes = [len(cluster) for cluster in clusters]
    shares = _share_out(count, sizes=sizes, limits=sizes)
    return tuple(
        pick
        for cluster, share in zip(clusters, shares, strict=True)
        if share
        for pick in _pick_in_cluster(links, first=cluster[0], eligible=cluster, count=share)[0]
    )


def choose_landmarks(
    adjacency: Mapping[int, Collection[int]], *, count: int, eligible: Collection[int], turn: int = 0
) -> tuple[ClusterChoice, ...]:
    """Pick landmarks as ``select_landmarks`` does, among some of the biobots, and from the first pick that covers best.

    Parameters
    ----------
    adjacency
        All that belong to the graph, those that may not be picked too, and whom each hears.
    count
        How many to pick, 0 to the number of those eligible.
    eligible
        Who may be picked.
    turn
        Of first picks that cover equally well, the one of this number is taken, counted round: another turn sees other places.

    Returns
    -------
    tuple of ClusterChoice
        Every cluster, by its lowest id, also where it gives none.

    Raises
    ------
    LandmarkCountError
        ``count`` is negative or exceeds the number of those eligible.

    Notes
    -----
    [Dir16] IV leaves the first pick open. Each of those eligible is tried, or ``MAX_STARTS`` at equal distances in the order of their
    ids; the best has the smallest radius, then the smallest sum of hops to the nearest pick; ties go by id. A cluster's share is in
    proportion to its size, and not more than it has of those eligible.
    """
    candidates = set(eligible) & adjacency.keys()
    if not 0 <= count <= len(candidates):
        raise LandmarkCountError(count=count, candidates=len(candidates))
    links = _symmetric_links(adjacency)
    clusters = _find_clusters(links)
    able = [[node for node in cluster if node in candidates] for cluster in clusters]
    shares = _share_out(count, sizes=[len(cluster) for cluster in clusters], limits=[len(some) for some in able])
    return tuple(
        _choose_in_cluster(links, cluster, eligible=some, count=share, turn=turn)
        for cluster, some, share in zip(clusters, able, shares, strict=True)
    )


def next_landmark(
    adjacency: Mapping[int, Collection[int]], *, standing: Collection[int], eligible: Collection[int], near: int | None = None
) -> int | None:
    """Return who takes the place of a landmark that is lost, or None where nobody can.

    It is in the cluster that has fewest landmarks for its size, and there the one with most hops to those that stand: where a
    landmark is gone, its surroundings are what is furthest from the others.

    Parameters
    ----------
    adjacency
        As of ``choose_landmarks``.
    standing
        Landmarks that stand, or have been asked to.
    eligible
        Who may be picked; those standing are passed over.
    near
        The landmark that is lost. Among equals it is the one with fewest hops to it, then the lowest id.
    """
    links = _symmetric_links(adjacency)
    clusters = _find_clusters(links)
    taken = set(standing) & links.keys()
    candidates = (set(eligible) & links.keys()) - taken
    sizes = [len(cluster) for cluster in clusters]
    shares = _share_out(min(len(taken) + 1, len(links)), sizes=sizes, limits=sizes)
    best: tuple[float, float, int, int] | None = None
    for cluster, share in zip(clusters, shares, strict=True):
        members = set(cluster)
        mine, free = sorted(members & taken), sorted(members & candidates)
        if not free:
            continue
        to_nearest = _hops_from(links, *mine)
        to_lost = _hops_from(links, near) if near in members else {}
        far = len(links)
        for node in free:
            rank = (share - len(mine), to_nearest.get(node, far), -to_lost.get(node, far), -node)
            best = rank if best is None else max(best, rank)
    return None if best is None else -best[3]


def _symmetric_links(adjacency: Mapping[int, Collection[int]]) -> dict[int, set[int]]:
    links: dict[int, set[int]] = {node: set() for node in sorted(adjacency)}
    for node, heard in adjacency.items():
        for other in heard:
            if other in links and other != node:
                links[node].add(other)
                links[other].add(node)
    return links


def _find_clusters(links: Mapping[int, set[int]]) -> list[list[int]]:
    """Return the connected components, each sorted, in order of their lowest id."""
    clusters: list[list[int]] = []
    seen: set[int] = set()
    for node in links:
        if node not in seen:
            hops = _hops_from(links, node)
            seen |= hops.keys()
            clusters.append(sorted(hops))
    return clusters


def _share_out(count: int, *, sizes: Sequence[int], limits: Sequence[int]) -> list[int]:
    """Divide ``count`` in proportion to ``sizes`` by largest remainder; what exceeds a limit goes to the others in the same order."""
    total = sum(sizes)
    shares = [min(count * size // total, limit) for size, limit in zip(sizes, limits, strict=True)]
    by_remainder = sorted(range(len(sizes)), key=lambda k: (-(count * sizes[k] % total), -sizes[k], k))
    rest = count - sum(shares)
    while rest > 0:
        for k in by_remainder:
            if rest and shares[k] < limits[k]:
                shares[k] += 1
                rest -= 1
    return shares


def _choose_in_cluster(
    links: Mapping[int, set[int]], cluster: Sequence[int], *, eligible: Sequence[int], count: int, turn: int
) -> ClusterChoice:
    if count == 0:
        return ClusterChoice(members=tuple(cluster), picks=(), radius=0)
    n_starts = min(MAX_STARTS, len(eligible))
    best: tuple[int, int] | None = None
    found: list[list[int]] = []
    for number in range(n_starts):
        picks, to_nearest = _pick_in_cluster(links, first=eligible[number * len(eligible) // n_starts], eligible=eligible, count=count)
        cover = (max(to_nearest.values()), sum(to_nearest.values()))
        if best is None or cover < best:
            best, found = cover, []
        if cover == best:
            found.append(picks)
    assert best is not None
    return ClusterChoice(members=tuple(cluster), picks=tuple(found[turn % len(found)]), radius=best[0])


def _pick_in_cluster(
    links: Mapping[int, set[int]], *, first: int, eligible: Collection[int], count: int
) -> tuple[list[int], dict[int, int]]:
    """Return ``count`` picks, and every member's hops to the nearest one."""
    picks = [first]
    to_nearest = _hops_from(links, first)
    # Hops only ever fall, so an entry that no longer holds is passed over; each node was pushed again when it fell.
    may_be = set(eligible)
    furthest = [(-to_nearest[node], node) for node in eligible]
    heapify(furthest)
    while len(picks) < count:
        hops, node = heappop(furthest)
        if -hops == to_nearest[node]:
            picks.append(node)
            for nearer in _come_nearer(links, node, to_nearest):
                if nearer in may_be:
                    heappush(furthest, (-to_nearest[nearer], nearer))
    return picks, to_nearest


def _come_nearer(links: Mapping[int, set[int]], pick: int, to_nearest: dict[int, int]) -> list[int]:
    """Lower the hops to the nearest pick where a new one is nearer, and return where it is: the search ends where it is not."""
    to_nearest[pick] = 0
    nearer = [pick]
    for node in nearer:  # grows while it is walked, breadth first
        hops = to_nearest[node] + 1
        for other in links[node]:
            if hops < to_nearest[other]:
                to_nearest[other] = hops
                nearer.append(other)
    return nearer


def _hops_from(links: Mapping[int, set[int]], *origins: int) -> dict[int, int]:
    """Count the hops from the nearest of some nodes to every node that can be reached, breadth first."""
    hops = dict.fromkeys(origins, 0)
    queue = deque(origins)
    while queue:
        node = queue.popleft()
        for other in links[node]:
            if other not in hops:
                hops[other] = hops[node] + 1
                queue.append(other)
    return hops
