"""Who stands still, found from encounters alone, and what a log is said to show."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from mapper.__main__ import main
from mapper.contact_statistics import measure_contacts
from mapper.kernels import choose_kernels
from mapper.stationary_search import find_stationary
from mapper.types import EncounterTable, KernelsKind
from mapper.window import make_encounter_table, select_rows
from tests.mapper.worlds import FIRST_LANDMARK, NS, table_of, walk_track

N_LANDMARKS = 12


@pytest.fixture(scope="module")
def ring() -> EncounterTable:
    """Sixteen walkers on a ring with twelve who stand, and meetings of walkers that are in one place."""
    rows, _ = walk_track(n_landmarks=N_LANDMARKS, n_walkers=16, duration_s=150, seed=1, is_ring=True)
    met = []
    rows.sort()
    for one, other in pairwise(rows):
        if one[3] == other[3] and one[2] != other[2] and other[0] - one[0] < NS // 4:
            met.append((other[0], other[1], one[2], other[2]))
    return table_of(rows + met)


def test_those_who_stand_are_found_whatever_they_are_called(ring: EncounterTable) -> None:
    standing = tuple(range(FIRST_LANDMARK, FIRST_LANDMARK + N_LANDMARKS))
    assert find_stationary(ring).nodes == standing
    names = np.random.default_rng(3).permutation(5000)
    renamed = make_encounter_table(t_start_ns=ring.t_start_ns, t_end_ns=ring.t_end_ns, id1=names[ring.id1], id2=names[ring.id2])
    assert find_stationary(renamed, kernels=choose_kernels(KernelsKind.PLAIN)).nodes == tuple(sorted(names[list(standing)].tolist()))


def test_where_all_walk_nobody_is_named(ring: EncounterTable) -> None:
    walkers = select_rows(ring, np.asarray(ring.id2 < FIRST_LANDMARK))
    assert find_stationary(walkers).nodes == ()


def test_readers_are_told_from_tags_though_neither_meet_their_own_kind(ring: EncounterTable) -> None:
    log = select_rows(ring, np.asarray(ring.id2 >= FIRST_LANDMARK))
    assert find_stationary(log).nodes == tuple(range(FIRST_LANDMARK, FIRST_LANDMARK + N_LANDMARKS))


def test_who_moves_half_way_does_not_stand(ring: EncounterTable) -> None:
    """Two who stand change places in the middle of the record: neither is named, and the others are or not, but none wrongly."""
    late = ring.t_start_ns > np.median(ring.t_start_ns)
    there, here = FIRST_LANDMARK, FIRST_LANDMARK + N_LANDMARKS // 2
    id2 = np.where(late & (ring.id2 == there), here, np.where(late & (ring.id2 == here), there, ring.id2))
    moved = make_encounter_table(t_start_ns=ring.t_start_ns, t_end_ns=ring.t_end_ns, id1=ring.id1, id2=id2)
    assert not {there, here} & set(find_stationary(moved).nodes)


def test_whom_one_phone_alone_hears_does_not_stand() -> None:
    """Its owner goes between two groups of people, who never hear each other: their distances are the same all the time."""
    group_a, group_b = range(10, 18), range(20, 28)
    rows = [
        ((100 * k + n) * NS, (100 * k + n) * NS, 1, device) for k in range(60) for n, device in enumerate(group_a if k % 2 else group_b)
    ]
    assert find_stationary(table_of(rows)).nodes == ()


def test_few_nodes_prove_nothing() -> None:
    assert find_stationary(table_of([(0, 1, 1, 2), (2, 3, 2, 3)])).nodes == ()


def test_silences_grids_periods_and_gatherings_are_measured() -> None:
    day = 86_400 * NS
    rows = [(k * 20 * NS, k * 20 * NS, 1 + k % 3, 4) for k in range(60)]
    one_day = measure_contacts(table_of(rows), np.array([], dtype=np.int64))
    assert (one_day.silences_ns, one_day.grid_ns, one_day.periods, one_day.n_walking) == ((), 20 * NS, 1, 4)
    assert one_day.unevenness is None
    others = [(start + day, end + day, one + 10, other + 10) for start, end, one, other in rows]
    two_days = measure_contacts(table_of(rows + others), np.array([4]))
    assert two_days.silences_ns == (day - 59 * 20 * NS,)
    assert (two_days.periods, two_days.n_walking) == (2, 7)
    gathering = [(0, 10 * NS, one, other) for one in range(5) for other in range(one)]
    # Of five who are together, either of a pair has three others each.
    assert measure_contacts(table_of(gathering), np.array([], dtype=np.int64)).at_once == 6.0


def test_chance_meetings_are_even_and_company_is_not() -> None:
    rng = np.random.default_rng(5)
    pairs = rng.integers(0, 40, (4000, 2))
    chance = [(k, k, int(one), int(other)) for k, (one, other) in enumerate(pairs) if one != other]
    company = [
        (k, k, int(one), int(one) // 4 * 4 + int(other) % 4) for k, (one, other) in enumerate(pairs) if int(one) % 4 != int(other) % 4
    ]
    even, uneven = (measure_contacts(table_of(rows), np.array([], dtype=np.int64)).unevenness for rows in (chance, company))
    assert even is not None
    assert uneven is not None
    assert even == pytest.approx(1.0, abs=0.15)
    assert uneven > 10


def _write_named(path: Path, table: EncounterTable) -> None:
    lines = [
        f"{start / NS:.3f},{end / NS:.3f},w{one},{'post ' if other >= FIRST_LANDMARK else 'w'}{other}\n"
        for start, end, one, other in zip(table.t_start_ns + NS, table.t_end_ns + NS, table.id1.tolist(), table.id2.tolist(), strict=True)
    ]
    path.write_text("start,end,who,whom\n" + "".join(lines))


def test_a_log_of_names_becomes_a_map_that_says_who_stands_and_what_is_not_known(
    ring: EncounterTable, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = tmp_path / "log.csv", tmp_path / "map.json"
    _write_named(log, ring)
    posts = [f"post {FIRST_LANDMARK + k}" for k in range(N_LANDMARKS)]
    common = ["run", str(log), "--columns", "id1=who,id2=whom", "--json", str(out)]
    assert main([*common, "--svg", str(tmp_path / "map.svg")]) == 0
    assert "stand still (found): post 1001, post 1002" in (tmp_path / "map.svg").read_text()
    told = capsys.readouterr()
    found = json.loads(out.read_text())
    assert found["stationary"]["source"] == "found"
    assert found["stationary"]["ids"] == posts
    assert "12 nodes are taken to stand still" in told.err
    assert "overrule with --stationary" in told.err
    assert "what cannot be concluded:" in told.out
    assert {name for point in found["points"] for name in (point["id1"], point["id2"])} <= {*posts, *(f"w{k}" for k in range(1, 17))}
    holds = {one["name"]: one["holds"] for one in found["assumptions"]}
    assert (holds["stands_still"], holds["known_speed"], holds["known_places"]) == (True, False, False)

    (tmp_path / "posts").write_text("\n".join(posts))
    assert main([*common, "--stationary", f"@{tmp_path / 'posts'}"]) == 0
    named = json.loads(out.read_text())
    assert (named["stationary"]["source"], named["points"], named["holes"]) == ("given", found["points"], found["holes"])

    assert main([*common, "--no-find-stationary"]) == 0
    assert "no node stands still, so distances measure time as much as place" in capsys.readouterr().out
    nobody = {one["name"]: one["holds"] for one in json.loads(out.read_text())["assumptions"]}
    assert (nobody["stands_still"], nobody["hole_count"]) == (False, False)

    assert main([*common, "--stationary", "post 1001,ghost"]) == 0
    assert "stationary biobots ghost are in no encounter" in capsys.readouterr().err
    assert main([*common, "--stationary", "ghost"]) == 1
    assert "no encounter has a biobot of --stationary ghost" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [["--columns", "who=1"], ["--time-unit", "fortnight"], ["--gap-s", "-1"], ["--gap-s", "inf"], ["--gap-s", "x"], ["--stationary", ""]],
)
def test_flags_that_say_nothing_good_are_bad_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["run", "log.csv", *arguments])
    assert left.value.code == 2
    assert "error: " in capsys.readouterr().err
