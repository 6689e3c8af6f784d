"""Who met whom lately: whether a biobot meets always the same, and whether the swarm has come apart. Pure."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mapper.groups import label_groups
from mapper.record_columns import EncounterRows, to_unsigned
from mapper.types import IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Contacts:
    """What there was in a span of time: encounters of each biobot, and groups that did not meet each other, the largest first."""

    n_encounters: Mapping[int, int]
    partners: Mapping[int, int]
    """How many others each of them met."""
    groups: tuple[tuple[int, ...], ...]


class RecentContacts:
    """Encounters that ended lately, by row of the store."""

    def __init__(self) -> None:
        # Columns: row of the store, end [ns], the two ids.
        self._rows: IntArray = np.zeros((4, 0), dtype=np.int64)

    def take(self, rows: EncounterRows, *, since_ns: int) -> None:
        """Take in rows that are new or have changed; forget what ended before an instant [ns since 1970]."""
        fresh = np.stack([rows.row, rows.t_end_ns, np.minimum(rows.id1, rows.id2), np.maximum(rows.id1, rows.id2)])[:, rows.counts]
        known = self._rows[:, ~np.isin(self._rows[0], rows.row)]
        whole = np.concatenate([known, fresh], axis=1)
        self._rows = whole[:, whole[1] >= since_ns]

    def contacts(self) -> Contacts:
        """Say what there was."""
        ids, places = np.unique(self._rows[2:], return_inverse=True)
        places = places.reshape(2, -1)
        n_encounters = np.bincount(places.ravel(), minlength=len(ids))
        pairs = np.unique(places, axis=1)
        partners = np.bincount(pairs.ravel(), minlength=len(ids))
        labels = label_groups(pairs[0], pairs[1], n=len(ids))
        names = [to_unsigned(node) for node in ids.tolist()]
        groups: defaultdict[int, list[int]] = defaultdict(list)
        for name, label in zip(names, labels.tolist(), strict=True):
            groups[label].append(name)
        return Contacts(
            n_encounters=dict(zip(names, n_encounters.tolist(), strict=True)),
            partners=dict(zip(names, partners.tolist(), strict=True)),
            groups=tuple(sorted((tuple(sorted(group)) for group in groups.values()), key=lambda group: (-len(group), group))),
        )
