"""What several gateways tell of is held in columns: no object for each record, and one for each pair."""

import tracemalloc
from itertools import pairwise

import numpy as np
import pytest

from firmware_protocol.units import NS_PER_S
from mapper.joint_encounters import JointEncounters, ToldRows
from mapper.record_columns import EncounterRows

N_MEETINGS = 4096
PIECE = 256


def told(first: int, *, row: int, gateway: int, n_pairs: int) -> ToldRows:
    """Return what a gateway tells of a piece of the meetings, ten seconds apart, which each last two."""
    number = np.arange(first, first + PIECE, dtype=np.int64)
    rows = EncounterRows(
        row=np.arange(row, row + PIECE, dtype=np.int64),
        t_start_ns=10 * NS_PER_S * number,
        t_end_ns=10 * NS_PER_S * number + 2 * NS_PER_S,
        id1=1 + number % n_pairs,
        id2=100_000 + number % n_pairs,
        counts=np.ones(PIECE, dtype=np.bool_),
    )
    nothing = np.zeros(PIECE, dtype=np.int64)
    return ToldRows(rows=rows, margin_ns=nothing, error_ns=nothing, gateway=nothing + gateway)


@pytest.mark.parametrize(("n_pairs", "most"), [(N_MEETINGS, 300), (64, 250)], ids=["all met once", "a few met often"])
def test_a_record_of_two_gateways_takes_few_bytes(n_pairs: int, most: int) -> None:
    """Columns take 88 bytes, and as much again in spare; a cover 24, and a pair's object and place 200."""
    pieces = [
        told(first, row=1 + 2 * first + gateway * PIECE, gateway=gateway, n_pairs=n_pairs)
        for first in range(0, N_MEETINGS, PIECE)
        for gateway in (0, 1)
    ]
    assert all(int(one.rows.row[-1]) + 1 == int(other.rows.row[0]) for one, other in pairwise(pieces))
    tracemalloc.start()
    try:
        joint = JointEncounters()
        for piece in pieces:
            amount = joint.take(piece, names={0: "a", 1: "b"})
        del amount
        taken, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    last = 2 * N_MEETINGS
    assert joint.members(last) == (last - PIECE, last)
    assert taken / last < most
