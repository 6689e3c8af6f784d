"""From the engine's records to events: rows become identities, numbers become modes, causes and reasons."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.engine.binding import EVENT, KIND_BEGIN, KIND_END, KIND_MODE
from simulator.engine.engine import Records
from simulator.events import (
    BackpackSilenced,
    Cause,
    EncounterBegan,
    EncounterEnded,
    EncounterTable,
    Event,
    Happenings,
    Mode,
    ModeChanged,
    SilenceReason,
)

MODES = (Mode.CRW, Mode.S)
"""By the engine's number."""
CAUSES = (Cause.NATURAL, Cause.COMMAND)
"""By the engine's number."""


def tell_events(records: Records, *, ids: Sequence[int], lost_first: NDArray[np.bool_]) -> Iterator[Event]:
    """Make an event of each record (dtype ``EVENT``).

    Parameters
    ----------
    ids
        Identity of each row.
    lost_first
        Whether a backpack that falls silent was lost, not flat, shape (n,).
    """
    for t_s, met_s, kind, first, second, cause in records.tolist():
        if kind == KIND_BEGIN:
            yield EncounterBegan(t_s=t_s, id1=ids[first], id2=ids[second])
        elif kind == KIND_END:
            yield EncounterEnded(t_start_s=met_s, t_end_s=t_s, id1=ids[first], id2=ids[second])
        elif kind == KIND_MODE:
            yield ModeChanged(t_s=t_s, id=ids[first], mode=MODES[second], cause=CAUSES[cause])
        else:
            reason = SilenceReason.LOST if lost_first[first] else SilenceReason.BATTERY
            yield BackpackSilenced(t_s=t_s, id=ids[first], reason=reason)


def tell_open(found: Records, *, ids: Sequence[int]) -> list[EncounterBegan]:
    """Tell of the encounters that have begun and not ended (rows of the engine's table), by start and ids."""
    began = sorted(zip(found["met_s"].tolist(), found["first"].tolist(), found["second"].tolist(), strict=True))
    return [EncounterBegan(t_s=t_s, id1=ids[first], id2=ids[second]) for t_s, first, second in began]


def tell_run(parts: Sequence[Records], *, ids: Sequence[int], lost_first: NDArray[np.bool_]) -> Happenings:
    """Put the encounters that ended into columns, and make events of all else but beginnings; parameters as in ``tell_events``."""
    records = np.concatenate([np.empty(0, dtype=EVENT), *parts])
    ends = records[records["kind"] == KIND_END]
    others = records[(records["kind"] != KIND_BEGIN) & (records["kind"] != KIND_END)]
    identities = np.array(ids, dtype=np.int64)
    table = EncounterTable(
        id1=identities[ends["first"]], id2=identities[ends["second"]], t_start_s=ends["met_s"].copy(), t_end_s=ends["t_s"].copy()
    )
    told = tell_events(others, ids=ids, lost_first=lost_first)
    return Happenings(ended=table, changes=[one for one in told if isinstance(one, ModeChanged | BackpackSilenced)])
