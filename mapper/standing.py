"""Who stands still in a log: as a person says, as modes say, as the name of a column says, or as the encounters prove."""

from collections.abc import Sequence

from mapper.errors import UnknownBiobotError
from mapper.kernels import Kernels
from mapper.reading import NodeNames
from mapper.stationary_search import find_stationary
from mapper.types import EncounterTable, Standing, StandingSource
from mapper.window import absent_biobots

_OVERRULE = "overrule with --stationary ID,ID or --no-find-stationary"


def choose_standing(
    table: EncounterTable,
    *,
    given: Sequence[int] | None,
    has_modes: bool,
    places: Sequence[int],
    place_column: str | None,
    searches: bool | None,
    kernels: Kernels,
) -> Standing:
    """Choose the nodes that are taken to stand still for the whole record.

    Parameters
    ----------
    given
        The nodes that a person named; None where none was. They win.
    has_modes
        Whether modes say who stood when: then nobody is looked for, unless ``searches`` is True.
    places, place_column
        Nodes that are places by their column's name, and that name.
    searches
        Whether to look for them in the encounters; None does so where nobody says anything. False takes the column's word for nothing, too.
    """
    if given is not None:
        return Standing(nodes=tuple(sorted(set(given))), source=StandingSource.GIVEN, reason="--stationary names them")
    if has_modes and not searches:
        return Standing(nodes=(), source=StandingSource.MODES, reason="--modes says who stood when")
    if searches is False:
        return Standing(nodes=(), source=StandingSource.NONE, reason="nobody was named, and --no-find-stationary was given")
    if places:
        reason = f"column {place_column!r} is a place by its name; {_OVERRULE}"
        return Standing(nodes=tuple(places), source=StandingSource.COLUMN, reason=reason)
    found = find_stationary(table, kernels=kernels)
    if found.nodes:
        return Standing(nodes=found.nodes, source=StandingSource.FOUND, reason=f"{found.reason}; {_OVERRULE}")
    source = StandingSource.MODES if has_modes else StandingSource.NONE
    return Standing(nodes=(), source=source, reason=f"{found.reason}; name those that do with --stationary ID,ID")


def number_given(table: EncounterTable, names: NodeNames, texts: Sequence[str]) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Return the numbers of ids that a person named, and those of them that are in no encounter.

    Raises
    ------
    UnknownBiobotError
        None of them is in any.
    """
    numbers = {text: names.number_of(text) for text in texts}
    known = [number for number in numbers.values() if number is not None]
    if not known:
        raise UnknownBiobotError(ids=texts)
    there = set(known) - set(absent_biobots(table, known))
    return tuple(sorted(there)), tuple(text for text, number in numbers.items() if number not in there)
