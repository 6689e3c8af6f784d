"""How true observed encounters are, in time: what share of all contact was noticed, and what share of what was noticed was contact."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence

from simulator.radios.proximity import common_time

Encounter = tuple[float, float, int, int]
"""Start and end [s] and the two identities, the smaller first."""


def compare(observed: Iterable[Encounter], true: Iterable[Encounter]) -> dict[str, float | int | None]:
    """Compare observed encounters with true ones of the same run; each pair's may touch, but not overlap.

    Returns
    -------
    dict
        ``true_contact_s``, ``observed_contact_s``
            Time in contact, over all pairs [s].
        ``sensitivity_in_time``
            Share of true contact time that is covered by observed encounters; None without any.
        ``precision_in_time``
            Share of observed contact time that is true; None without any.
        ``true_encounters``, ``observed_encounters``
            How many.
        ``detected_share``
            Share of true encounters during which, or within no time of which, an observed one of the pair lasts; None without any.
        ``false_share``
            Share of observed encounters that no true one of the pair meets; None without any.
        ``matched``, ``mean_duration_error_s``
            True encounters that meet one observed one which meets no other; and how much longer on average the latter lasts
            [s; negative: shorter]; None without any.
    """
    seen, met = _by_pair(observed), _by_pair(true)
    common_s = sum(common_time(seen[pair], met[pair]) for pair in seen.keys() & met.keys())
    seen_s, met_s = (sum(end - start for spells in one.values() for start, end in spells) for one in (seen, met))
    n_seen, n_met = (sum(map(len, one.values())) for one in (seen, met))
    n_detected = sum(_count_met(spells, seen.get(pair, [])) for pair, spells in met.items())
    errors_s = [error_s for pair in seen.keys() & met.keys() for error_s in _duration_errors(seen[pair], met[pair])]
    n_false = n_seen - sum(_count_met(spells, met.get(pair, [])) for pair, spells in seen.items())
    return {
        "true_contact_s": round(met_s, 6),
        "observed_contact_s": round(seen_s, 6),
        "sensitivity_in_time": _share(common_s, met_s),
        "precision_in_time": _share(common_s, seen_s),
        "true_encounters": n_met,
        "observed_encounters": n_seen,
        "detected_share": _share(n_detected, n_met),
        "false_share": _share(n_false, n_seen),
        "matched": len(errors_s),
        "mean_duration_error_s": _share(math.fsum(errors_s), len(errors_s)),
    }


def _by_pair(encounters: Iterable[Encounter]) -> dict[tuple[int, int], list[tuple[float, float]]]:
    of_pair: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for start, end, id1, id2 in sorted(encounters):
        of_pair.setdefault((id1, id2), []).append((start, end))
    return of_pair


def _count_met(spells: Sequence[tuple[float, float]], others: Sequence[tuple[float, float]]) -> int:
    """Count the spells that one of the others touches."""
    count, j = 0, 0
    for start, end in spells:
        while j < len(others) and others[j][1] < start:
            j += 1
        count += j < len(others) and others[j][0] <= end
    return count


def _duration_errors(seen: Sequence[tuple[float, float]], met: Sequence[tuple[float, float]]) -> list[float]:
    """Return by how much observed encounters outlast true ones, where each meets the other and no further one [s]."""
    links: list[tuple[int, int]] = []
    j = 0
    for i, (start, end) in enumerate(seen):
        while j < len(met) and met[j][1] < start:
            j += 1
        k = j
        while k < len(met) and met[k][0] <= end:
            links.append((i, k))
            k += 1
    n_seen, n_met = Counter(i for i, _ in links), Counter(k for _, k in links)
    return [(seen[i][1] - seen[i][0]) - (met[k][1] - met[k][0]) for i, k in links if n_seen[i] == n_met[k] == 1]


def _share(part: float, whole: float) -> float | None:
    return round(part / whole, 6) if whole else None
