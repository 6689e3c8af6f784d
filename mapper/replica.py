"""The computing process's copy of what maps are made of, kept in step with the store by sending what has changed."""

from dataclasses import dataclass

from firmware_protocol.contract.records import ModeRecord
from mapper.encounter_set import EncounterSet
from mapper.mode_spells import ModeSpells
from mapper.record_columns import EncounterRows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoreDelta:
    """What leads from the store at change ``base`` to the store at ``change``; from base 0 it is everything.

    ``modes`` has row, change and record. ``since_ns`` is time 0, the moment the landmarks were set [wall clock]; None where no mission
    did that.
    """

    base: int
    change: int
    encounters: EncounterRows
    modes: tuple[tuple[int, int, ModeRecord], ...]
    since_ns: int | None


class Replica:
    """Encounters and mode spells of a store as they were at ``change``; 0 is before everything."""

    def __init__(self) -> None:
        self.change = 0
        self.since_ns: int | None = None
        self.encounters = EncounterSet()
        self.modes = ModeSpells()

    def take(self, delta: StoreDelta) -> bool:
        """Bring the copy up to date; False, and nothing is done, where the delta does not begin where the copy is."""
        if delta.base == 0:
            self.encounters, self.modes = EncounterSet(), ModeSpells()
        elif delta.base != self.change:
            return False
        # Half taken in, it fits no delta but one of everything.
        self.change = -1
        self.encounters.take(delta.encounters)
        for row, change, record in delta.modes:
            self.modes.put(row, record, change=change)
        self.since_ns = delta.since_ns
        self.change = delta.change
        return True
