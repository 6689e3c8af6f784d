"""Who stands still: landmarks picked by hop-distance maxmin on the communication graph.

The rule of [Dir16] IV, "Exploration and Event Collection": from a connected graph, landmarks are picked one by one, each as many
hops away from those before it as can be; of a graph in several clusters, each cluster gives a share in proportion to its size.

[Dir16]: A. Dirafzoon, A. Bozkurt, E. Lobaton, "Geometric Learning and Topological Inference with Biobotic Networks", 2016.
"""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from heapq import heapify, heappop, heappush

from firmware_protocol.errors import LandmarkCountError


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
    shares = _share_out(count, sizes=[len(cluster) for cluster in clusters])
    return tuple(pick for cluster, share in zip(clusters, shares, strict=True) for pick in _pick_in_cluster(links, cluster, count=share))


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


def _share_out(count: int, *, sizes: Sequence[int]) -> list[int]:
    """Divide ``count`` in proportion to ``sizes`` by largest remainder; no share exceeds its size."""
    total = sum(sizes)
    shares = [count * size // total for size in sizes]
    by_remainder = sorted(range(len(sizes)), key=lambda k: (-(count * sizes[k] % total), -sizes[k], k))
    for k in by_remainder[: count - sum(shares)]:
        shares[k] += 1
    return shares


def _pick_in_cluster(links: Mapping[int, set[int]], cluster: Sequence[int], *, count: int) -> list[int]:
    if count == 0:
        return []
    picks = [cluster[0]]
    to_nearest = _hops_from(links, cluster[0])
    # Hops only ever fall, so an entry that no longer holds is passed over; each node was pushed again when it fell.
    furthest = [(-hops, node) for node, hops in to_nearest.items()]
    heapify(furthest)
    while len(picks) < count:
        hops, node = heappop(furthest)
        if -hops == to_nearest[node]:
            picks.append(node)
            for nearer in _come_nearer(links, node, to_nearest):
                heappush(furthest, (-to_nearest[nearer], nearer))
    return picks


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


def _hops_from(links: Mapping[int, set[int]], origin: int) -> dict[int, int]:
    """Count the hops to every node that can be reached, breadth first."""
    hops = {origin: 0}
    queue = deque([origin])
    while queue:
        node = queue.popleft()
        for other in links[node]:
            if other not in hops:
                hops[other] = hops[node] + 1
                queue.append(other)
    return hops
