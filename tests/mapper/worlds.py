"""Small worlds of known shape, walked by hand-made biobots, and Hypothesis strategies for encounters and mode spells."""

import numpy as np
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, Mode
from firmware_protocol.units import NodeId
from mapper.types import EncounterTable, ModeSpell
from mapper.window import make_encounter_table

Row = tuple[int, int, int, int]

NS = 1_000_000_000
FIRST_LANDMARK = 1001


def table_of(rows: list[Row]) -> EncounterTable:
    columns = list(zip(*rows, strict=True)) or [(), (), (), ()]
    return make_encounter_table(t_start_ns=columns[0], t_end_ns=columns[1], id1=columns[2], id2=columns[3])


@st.composite
def encounter_rows(draw: st.DrawFn, *, max_size: int = 9, n_biobots: int = 5) -> list[Row]:
    """Few encounters of few biobots at few instants: ties, intervals of no length, and several components are common."""
    rows = []
    for _ in range(draw(st.integers(1, max_size))):
        start = draw(st.integers(0, 12))
        first, second = draw(st.lists(st.integers(1, n_biobots), min_size=2, max_size=2, unique=True))
        rows.append((start, start + draw(st.integers(0, 4)), first, second))
    return rows


mode_spells = st.lists(
    st.builds(
        lambda node, start, length, mode, cause: ModeSpell(
            node=NodeId(node), t_start_ns=start, t_end_ns=None if length is None else start + length, mode=mode, cause=cause
        ),
        st.integers(1, 6),
        st.integers(-2, 14),
        st.none() | st.integers(0, 9),
        st.sampled_from([Mode.S, Mode.S, Mode.S, Mode.CRW]),
        st.sampled_from(Cause),
    ),
    max_size=5,
)


def walk_track(*, n_landmarks: int, n_walkers: int, duration_s: float, seed: int, is_ring: bool) -> tuple[list[Row], tuple[ModeSpell, ...]]:
    """Let biobots walk along a ring or a corridor of length ``n_landmarks`` seconds with a landmark at every second of it.

    A walker goes 1 per second, turns round after exponential times of mean ``n_landmarks / 2`` (and at the ends of a corridor), and meets
    each landmark for 20 ms as it passes.
    """
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    for walker in range(1, n_walkers + 1):
        at, time, direction = float(rng.uniform(0.1, n_landmarks - 1.1)), 0.0, 1
        while time < duration_s:
            goal = at + direction * float(rng.exponential(n_landmarks / 2))
            if not is_ring:
                goal = min(max(goal, -0.2), n_landmarks - 0.8)
            passed = np.arange(np.ceil(min(at, goal)), np.floor(max(at, goal)) + 1)
            for landmark in passed:
                centre = round((time + abs(landmark - at)) * NS)
                rows.append((centre - NS // 100, centre + NS // 100, walker, FIRST_LANDMARK + int(landmark) % n_landmarks))
            time, at, direction = time + abs(goal - at), goal, -direction
    begin = min(row[0] for row in rows)
    spells = tuple(
        ModeSpell(node=NodeId(FIRST_LANDMARK + k), t_start_ns=begin, t_end_ns=None, mode=Mode.S, cause=Cause.COMMAND)
        for k in range(n_landmarks)
    )
    return rows, spells
