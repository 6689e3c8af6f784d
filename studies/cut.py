"""A table of encounters cut from a simulated run, with its landmarks, as one file."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.types import EncounterTable, IntArray, ModeSpell, read_only
from studies.errors import CutFileError

COLUMNS = ("t_start_ns", "t_end_ns", "id1", "id2")
"""Of the table, as `mapper.window.make_encounter_table` takes them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cut:
    """The encounters that had ended at one moment of the run, in canonical order, and the ids of the landmarks, ascending."""

    table: EncounterTable
    landmarks: IntArray

    @property
    def spells(self) -> tuple[ModeSpell, ...]:
        """The landmarks' spells: by command, from time 0, without end."""
        return tuple(
            ModeSpell(node=NodeId(node), t_start_ns=0, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND) for node in self.landmarks.tolist()
        )

    def first(self, n: int) -> "Cut":
        """Return a table of the n encounters that began first."""
        table = self.table
        columns = {name: getattr(table, name)[:n] for name in (*COLUMNS, "source_row")}
        return Cut(table=EncounterTable(**columns), landmarks=self.landmarks)


def load_cut(path: Path) -> Cut:
    """Read a table that `store_cut` wrote.

    Raises
    ------
    CutFileError
        The file is missing or no such table.
    """
    try:
        with np.load(path) as content:
            columns = {name: read_only(content[name]) for name in COLUMNS}
            landmarks = read_only(content["landmarks"])
    except (OSError, KeyError, ValueError) as error:
        raise CutFileError(path=path, problem=str(error)) from error
    source_row = read_only(np.arange(len(columns["id1"]), dtype=np.int64))
    return Cut(table=EncounterTable(**columns, source_row=source_row), landmarks=landmarks)


def store_cut(cut: Cut, path: Path) -> None:
    """Write a table; the file appears whole or not at all."""
    unfinished = path.with_suffix(f".{os.getpid()}.part")
    with unfinished.open("wb") as file:
        np.savez(file, landmarks=cut.landmarks, **{name: getattr(cut.table, name) for name in COLUMNS})
    unfinished.replace(path)
