"""A journal of biobots that walked a ring: its map has one component and one hole."""

from functools import cache

from firmware_protocol.contract.records import JournalRecord
from mapper.config import RecipeConfig, make_recipe
from mapper.map_codec import encode_map
from mapper.pipeline import compute_map
from tests.mapper.fake_gateway import encounter, mode
from tests.mapper.worlds import table_of, walk_track


def ring_records() -> list[JournalRecord]:
    """Return mode records of twenty landmarks (ids from 1001), then about 700 encounters of ten walkers (ids from 1)."""
    rows, spells = walk_track(n_landmarks=20, n_walkers=10, duration_s=60.0, seed=1, is_ring=True)
    records: list[JournalRecord] = [
        mode(offset, node=spell.node, t_ns=(spell.t_start_ns, spell.t_end_ns)) for offset, spell in enumerate(spells, start=1)
    ]
    records += [
        encounter(offset, nodes=(first, second), t_ns=(begin, end))
        for offset, (begin, end, first, second) in enumerate(sorted(rows), start=len(records) + 1)
    ]
    return records


@cache
def ring_map() -> bytes:
    """Return the same ring's map, as `mapper.map_codec` writes it."""
    rows, spells = walk_track(n_landmarks=20, n_walkers=10, duration_s=60.0, seed=1, is_ring=True)
    return encode_map(compute_map(table_of(rows), spells, make_recipe(RecipeConfig())))
