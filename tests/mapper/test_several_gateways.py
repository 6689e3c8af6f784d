"""Several gateways of one site: each encounter once, all on one clock, whatever came first."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import msgspec.structs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import UNSET, UnsetType

from firmware_protocol.contract.records import EncounterRecord, EncounterSide, MissionPhase, MissionRecord, ModeRecord, OwnSpan
from firmware_protocol.units import BootId, Nanoseconds, NodeId, RssiDbm
from mapper.clock_votes import FLOOR_NS
from mapper.errors import StoreError
from mapper.mode_spells import ModeSpells
from mapper.replica import Replica
from mapper.row_loader import LoadedEncounters, load_encounters
from mapper.site_view import SiteView
from mapper.store import Kind, Store
from tests.mapper.fake_gateway import ANCHOR_NS, S, batch, encounter, mission, mode
from tests.mapper.site import Meeting, batches, encounters_of, heard, meetings, offsets_s

GATEWAYS = ("north", "south", "west")
Interval = tuple[int, int, int, int]


def joined_plainly(records: list[EncounterRecord]) -> list[Interval]:
    """The rule, told slowly: what covers or ticks connect, where two gateways at least tell of it; else each by itself."""
    newest: dict[object, EncounterRecord] = {}
    for record in records:
        if record.identity not in newest or record.revision > newest[record.identity].revision:
            newest[record.identity] = record
    found: list[Interval] = []
    counting = [record for record in newest.values() if not record.is_void]
    for nodes in {(record.node_a, record.node_b) for record in counting}:
        pieces: list[list[EncounterRecord]] = []
        for record in [record for record in counting if (record.node_a, record.node_b) == nodes]:
            touching = [piece for piece in pieces if any(covers_overlap(one, record) or told_alike(one, record) for one in piece)]
            pieces = [piece for piece in pieces if piece not in touching] + [[record, *(one for piece in touching for one in piece)]]
        for piece in pieces:
            parts = [piece] if len({record.gateway for record in piece}) > 1 else [[record] for record in piece]
            for part in parts:
                begin = agreed_plainly([(one.t_start_ns, one.error_ns) for one in part])
                found.append((begin, max(begin, -agreed_plainly([(-one.t_end_ns, one.error_ns) for one in part])), *nodes))
    return sorted(found)


def covers_overlap(one: EncounterRecord, other: EncounterRecord) -> bool:
    return (
        one.t_start_ns - one.margin_ns <= other.t_end_ns + other.margin_ns
        and other.t_start_ns - other.margin_ns <= one.t_end_ns + one.margin_ns
    )


def told_alike(one: EncounterRecord, other: EncounterRecord) -> bool:
    """Whether a biobot told both of the same tick of one of its lives, tick by tick."""

    def ticks(record: EncounterRecord) -> set[tuple[int, int, int]]:
        told = [(side.node, side.own_clock) for side in record.sides]
        spans = [(node, own) for node, own in told if not isinstance(own, UnsetType)]
        return {(node, own.boot, tick) for node, own in spans for tick in range(own.start_ms, own.end_ms + 1)}

    return bool(ticks(one) & ticks(other))


def a_side(node: int, own: OwnSpan | UnsetType, *, t_ns: tuple[int, int], error_ns: int = 0) -> EncounterSide:
    return EncounterSide(
        node=NodeId(node),
        t_start_ns=Nanoseconds(t_ns[0]),
        t_end_ns=Nanoseconds(t_ns[1]),
        rssi_dbm=RssiDbm(-60),
        error_ns=Nanoseconds(error_ns),
        own_clock=own,
    )


def agreed_plainly(told: list[tuple[int, int]]) -> int:
    """The middle of the instants that the first, and of the others each that leaves any, all allow; counted one by one."""
    allowed: set[int] = set()
    for instant, error in sorted(told):
        allowed = (
            (allowed & set(range(instant - error, instant + error + 1))) or allowed or set(range(instant - error, instant + error + 1))
        )
    return (min(allowed) + max(allowed)) // 2


def own_spans() -> st.SearchStrategy[OwnSpan | UnsetType]:
    """Of two starts of a backpack, some ticks each; sometimes not told."""
    spans = st.tuples(st.integers(0, 1), st.integers(0, 40), st.integers(0, 4))
    return st.just(UNSET) | spans.map(lambda one: OwnSpan(BootId(one[0]), one[1], one[1] + one[2]))


@st.composite
def journals(draw: st.DrawFn) -> list[EncounterRecord]:
    """What up to three gateways tell of two pairs, corrections among it; clocks are right, and margins as told.

    Biobots' own clocks have nothing to do with the instants here, so that encounters are connected by either alone, and by both.
    """
    records: list[EncounterRecord] = []
    for gateway in draw(st.lists(st.sampled_from(GATEWAYS), min_size=1, max_size=3, unique=True)):
        revisions: dict[int, int] = {}
        for offset in range(1, draw(st.integers(1, 9)) + 1):
            sequence = draw(st.integers(0, 5))
            revisions[sequence] = revisions.get(sequence, -1) + 1
            begin = draw(st.integers(0, 30))
            record = encounter(
                offset,
                sequence=sequence,
                revision=revisions[sequence],
                nodes=(1, 2 + sequence % 2),
                t_ns=(begin, begin + draw(st.integers(0, 6))),
                gateway=gateway,
                is_void=draw(st.sampled_from([False, False, True])),
            )
            error = draw(st.integers(0, 3))
            margin = draw(st.integers(error, 4))
            sides = tuple(
                a_side(node, draw(own_spans()), t_ns=(record.t_start_ns, record.t_end_ns))
                for node in draw(st.sets(st.sampled_from((record.node_a, record.node_b))))
            )
            records.append(msgspec.structs.replace(record, margin_ns=margin, error_ns=Nanoseconds(error), sides=sides))
    return records


@settings(max_examples=80)
@given(records=journals(), data=st.data())
def test_an_encounter_that_several_gateways_tell_of_counts_once_in_whatever_order_and_batches_they_do(
    records: list[EncounterRecord], data: st.DataObject
) -> None:
    order = data.draw(st.permutations(records))
    wanted = joined_plainly(records)
    with closing(Store(None)) as at_once, closing(Store(None)) as piecemeal:
        at_once.apply(batches(records))
        while order:
            size = data.draw(st.integers(1, len(order)))
            piecemeal.apply(batches(order[:size]))
            order = order[size:]
        assert encounters_of(piecemeal) == encounters_of(at_once) == wanted
        assert piecemeal.n_encounters == piecemeal.progress.n_encounters == len(wanted)
        assert dict(piecemeal.count_by_node()) == dict(at_once.count_by_node())


@settings(max_examples=30)
@given(records=journals())
def test_a_copy_that_is_sent_only_what_has_changed_has_all(records: list[EncounterRecord]) -> None:
    replica = Replica()
    with closing(Store(None)) as store:
        for one in batches(records):
            store.apply([one])
            assert replica.take(store.delta(after=replica.change))
        table = replica.encounters.table()
        rows = zip(table.t_start_ns - ANCHOR_NS, table.t_end_ns - ANCHOR_NS, table.id1, table.id2, strict=True)
        assert [tuple(map(int, row)) for row in rows] == joined_plainly(records)


@pytest.mark.parametrize("ahead_s", [-86_400.5, -240.0, 0.9, 7200.0])
def test_a_clock_that_is_wrong_is_found_out_by_shared_encounters_and_each_counts_once(ahead_s: float) -> None:
    what = meetings(400, seed=3)
    with closing(Store(None)) as store:
        store.apply(batches(heard(what, gateway="north", jitter_s=0.2, seed=1, margin_ns=S // 2)))
        store.apply(batches(heard(what, gateway="south", jitter_s=0.2, seed=2, margin_ns=S // 2, ahead_s=ahead_s)))
        found = encounters_of(store)
        clocks = {clock.source.gateway: clock for clock in store.clocks}
    assert len(found) == len(what)
    assert max(abs(begin - one.begin_ns) for (begin, *_), one in zip(found, what, strict=True)) <= 0.3 * S
    south = clocks["south"]
    assert south.offset_ns is not None
    assert abs(south.offset_ns + ahead_s * S) <= south.bound_ns <= 0.15 * S
    assert (south.reference.gateway, south.n_votes, south.is_corrected) == ("north", len(what), True)
    assert (clocks["north"].offset_ns, clocks["north"].is_corrected) == (0, False)


def test_clocks_that_agree_within_what_can_be_known_are_left_alone() -> None:
    what = meetings(300, seed=4)
    with closing(Store(None)) as store:
        store.apply(
            batches(heard(what, gateway="north", jitter_s=0.2, seed=1) + heard(what, gateway="south", ahead_s=0.004, seed=2, jitter_s=0.2))
        )
        assert len(encounters_of(store)) == len(what)
        assert [(clock.is_corrected, clock.n_votes) for clock in store.clocks] == [(False, 0), (False, len(what))]


def test_records_that_are_dated_badly_have_no_vote_on_a_gateways_clock() -> None:
    """Two thirds of what south tells come 0.9 s late, and say so."""
    what = meetings(300, seed=4)
    with closing(Store(None)) as store:
        store.apply(batches(heard(what, gateway="north")))
        for number, good in enumerate(heard(what, gateway="south")):
            t_ns = (good.t_start_ns + 900_000_000, good.t_end_ns + 900_000_000)
            told = own(good.t_start_ns // 1_000_000, good.t_end_ns // 1_000_000)
            side = a_side(good.node_a, told, t_ns=t_ns, error_ns=950_000_000)
            record = msgspec.structs.replace(good, t_start_ns=Nanoseconds(t_ns[0]), t_end_ns=Nanoseconds(t_ns[1]), sides=(side,))
            store.apply(batches([record if number % 3 else good]))
        store.delta(after=0)
        (south,) = [clock for clock in store.clocks if clock.source.gateway == "south"]
    assert (south.offset_ns, south.n_votes) == (0, len(what[::3]))


def test_chance_meetings_of_two_gateways_say_nothing_of_their_clocks() -> None:
    with closing(Store(None)) as store:
        store.apply(batches(heard(meetings(900, seed=5, n_pairs=9), gateway="north")))
        store.apply(batches(heard(meetings(900, seed=6, n_pairs=9), gateway="south")))
        store.delta(after=0)
        assert offsets_s(store) == {"north": None, "south": None}
        assert {clock.reference.gateway for clock in store.clocks} == {"north", "south"}


def test_a_drift_of_hosts_is_followed_for_days() -> None:
    what = meetings(2500, seed=7, span_s=2 * 86_400.0)
    with closing(Store(None)) as store:
        store.apply(batches(heard(what, gateway="north", margin_ns=S // 10)))
        store.apply(batches(heard(what, gateway="south", margin_ns=S // 10, ahead_s=-3600, drift=40e-6)))
        found = encounters_of(store)
    assert len(found) == len(what)
    assert max(abs(begin - one.begin_ns) for (begin, *_), one in zip(found, what, strict=True)) <= S // 10


def test_gateways_are_aligned_over_others_that_they_share_backpacks_with_and_the_majority_is_right() -> None:
    what = meetings(900, seed=8)
    with closing(Store(None)) as store:
        store.apply(batches(heard(what[:300], gateway="a", ahead_s=500)))
        store.apply(batches(heard(what[150:], gateway="b")))
        store.apply(batches(heard(what[400:], gateway="c", ahead_s=0.001)))
        assert len(encounters_of(store)) == len(what)
        assert offsets_s(store)["a"] == pytest.approx(-500, abs=0.03)
        assert {clock.reference.gateway for clock in store.clocks} == {"b"}


def test_each_start_of_a_gateway_has_a_clock_of_its_own() -> None:
    what = meetings(600, seed=9)
    with closing(Store(None)) as store:
        store.apply(batches(heard(what, gateway="north")))
        store.apply(batches(heard(what[:250], gateway="south", ahead_s=-900)))
        store.apply(batches(heard(what[250:], gateway="south", ahead_s=0.0, first=1000)))
        assert len(encounters_of(store)) == len(what)
        offsets = [clock.offset_ns for clock in store.clocks if clock.source.gateway == "south"]
        assert offsets == [900 * S, 0]


@settings(max_examples=12)
@given(seed=st.integers(0, 50), data=st.data())
def test_clocks_come_out_alike_whatever_came_first(seed: int, data: st.DataObject) -> None:
    what = meetings(60, seed=seed, n_pairs=6)
    records = heard(what, gateway="north", seed=seed, jitter_s=0.1) + heard(
        what[5:], gateway="south", ahead_s=120, seed=seed + 1, jitter_s=0.1
    )
    records += heard(what[:40], gateway="west", ahead_s=-5, seed=seed + 2, jitter_s=0.1)
    order = data.draw(st.permutations(records))
    with closing(Store(None)) as at_once, closing(Store(None)) as piecemeal:
        at_once.apply(batches(records))
        for first in range(0, len(order), 37):
            piecemeal.apply(batches(order[first : first + 37]))
            piecemeal.delta(after=0)
        assert encounters_of(piecemeal) == encounters_of(at_once)
        assert piecemeal.clocks == at_once.clocks
        assert len(encounters_of(at_once)) == len(what)


def test_a_reopened_store_says_the_same(tmp_path: Path) -> None:
    what = meetings(300, seed=10)
    records = heard(what, gateway="north") + heard(what, gateway="south", ahead_s=60)
    with closing(Store(tmp_path / "store")) as store:
        store.apply(batches(records))
        before, n_before = encounters_of(store), store.n_encounters
        clocks = store.clocks
    with closing(Store(tmp_path / "store")) as store:
        assert (store.n_encounters, store.progress.n_encounters) == (n_before, n_before) == (len(what), len(what))
        assert (encounters_of(store), store.clocks) == (before, clocks)


def test_a_correction_or_a_void_of_either_record_is_followed() -> None:
    one, other = encounter(1, t_ns=(0, 4 * S), gateway="north"), encounter(1, t_ns=(3 * S, 6 * S), gateway="south")
    with closing(Store(None)) as store:
        store.apply(batches([one, other]))
        assert encounters_of(store) == [(0, 6 * S, 1, 2)]
        store.apply(batches([msgspec.structs.replace(other, offset=2, revision=1, t_end_ns=Nanoseconds(9 * S))]))
        assert encounters_of(store) == [(0, 9 * S, 1, 2)]
        store.apply(batches([msgspec.structs.replace(one, offset=2, revision=1, is_void=True)]))
        assert encounters_of(store) == [(3 * S, 9 * S, 1, 2)]
        store.apply(batches([msgspec.structs.replace(one, offset=3, revision=2, t_end_ns=Nanoseconds(2 * S))]))
        assert encounters_of(store) == [(0, 2 * S, 1, 2), (3 * S, 9 * S, 1, 2)]


def own(start_ms: int, end_ms: int, *, boot: int = 7) -> OwnSpan:
    return OwnSpan(BootId(boot), start_ms, end_ms)


def told_by(gateway: str, *, t_ms: tuple[int, int], told: OwnSpan, node: int = 1, error_ms: int = 2, ahead_s: int = 0) -> EncounterRecord:
    """One side's record of an encounter, by a gateway whose clock is ahead; so badly dated a gateway knows no margin but 0.1 s."""
    t_ns = (t_ms[0] * 1_000_000, t_ms[1] * 1_000_000)
    record = encounter(1, t_ns=t_ns, gateway=gateway)
    return msgspec.structs.replace(
        record,
        error_ns=Nanoseconds(error_ms * 1_000_000),
        margin_ns=min(error_ms, 100) * 1_000_000,
        wall_anchor_ns=Nanoseconds(ANCHOR_NS + ahead_s * S),
        sides=(a_side(node, told, t_ns=t_ns, error_ns=error_ms * 1_000_000),),
    )


@pytest.mark.parametrize("late_ms", [-6_000, -1_900, 1_900, 6_000])
@pytest.mark.parametrize("first", [0, 1])
def test_a_report_that_is_told_again_to_a_gateway_that_dates_it_wrong_counts_once_and_when_it_was(late_ms: int, first: int) -> None:
    right = told_by("north", t_ms=(60_000, 63_000), told=own(5_000, 8_000))
    wrong = told_by("south", t_ms=(60_000 + late_ms, 63_000 + late_ms), told=own(5_000, 8_000), error_ms=2_000)
    with closing(Store(None)) as store:
        store.apply(batches([right, wrong] if first else [wrong, right]))
        assert encounters_of(store) == [(60 * S, 63 * S, 1, 2)]
        assert store.n_encounters == 1


def test_a_gateway_whose_clock_is_wrong_and_not_set_right_yet_doubles_nothing_that_both_were_told() -> None:
    """Too few are shared for votes: of clocks that are known equally well that of the first name counts."""
    north = told_by("north", t_ms=(60_000, 63_000), told=own(5_000, 8_000))
    south = told_by("south", t_ms=(60_000, 64_000), told=own(5_000, 9_000), ahead_s=300)
    with closing(Store(None)) as store:
        store.apply(batches([south, north]))
        assert encounters_of(store) == [(60 * S, 64 * S, 1, 2)]


@pytest.mark.parametrize(
    ("told", "node", "ahead_s"),
    [
        (own(5_000, 8_000, boot=8), 1, 0),  # another start
        (own(8_001, 8_000 + 3_001), 1, 0),  # ticks later
        (own(5_000, 8_000), 2, 0),  # the other biobot's clock
        (own(5_000, 8_000), 1, 90_000),  # a count of starts that began anew: more than a day apart
    ],
)
def test_what_no_tick_is_shared_of_stays_apart(told: OwnSpan, node: int, ahead_s: int) -> None:
    north = told_by("north", t_ms=(60_000, 63_000), told=own(5_000, 8_000))
    south = told_by("south", t_ms=(70_000, 73_000), told=told, node=node, ahead_s=ahead_s)
    with closing(Store(None)) as store:
        store.apply(batches([north, south]))
        assert store.n_encounters == 2


def test_numbers_that_no_clock_shows_count_as_not_told() -> None:
    north = told_by("north", t_ms=(60_000, 63_000), told=own(0, 2**32 - 1))
    for told in (own(-1, 5), own(9, 5), own(2**32, 2**33), own(0, 2**63, boot=2**40)):
        with closing(Store(None)) as store:
            store.apply(batches([north, told_by("south", t_ms=(70_000, 73_000), told=told)]))
            assert store.n_encounters == 2
    last = told_by("south", t_ms=(60_000 + 2**32 - 1, 60_000 + 2**32), told=own(2**32 - 1, 2**62))
    with closing(Store(None)) as store:
        store.apply(batches([north, last]))
        assert store.n_encounters == 1


def test_modes_and_missions_of_a_gateway_are_on_the_sites_clock_too() -> None:
    what = meetings(100, seed=11)
    with closing(Store(None)) as store:
        store.apply(batches(heard(what, gateway="gateway0")))
        wrong = heard(what, gateway="gateway1", ahead_s=300)
        anchor = wrong[0].wall_anchor_ns
        others: list[ModeRecord | MissionRecord] = [
            mode(900, node=5, t_ns=(7 * S, 9 * S)),
            mission(901, phase=MissionPhase.EXPLORATION, t_ns=5 * S),
        ]
        moved = [msgspec.structs.replace(one, wall_anchor_ns=anchor, journal="journal of gateway1") for one in others]
        store.apply([*batches(wrong), batch(moved, journal="journal of gateway1")])
        delta = store.delta(after=0)
        spells = ModeSpells()
        for row, change, record in delta.modes:
            spells.put(row, record, change=change)
        assert [(spell.t_start_ns - ANCHOR_NS, (spell.t_end_ns or 0) - ANCHOR_NS) for spell in spells.spells()] == [(7 * S, 9 * S)]
        assert delta.since_ns == ANCHOR_NS + 5 * S


def test_with_one_gateway_rows_are_what_came_and_nothing_else() -> None:
    overlapping = [encounter(n, t_ns=(n * S, (n + 3) * S)) for n in range(1, 30)]
    with closing(Store(None)) as store:
        store.apply(batches(overlapping))
        rows = store.delta(after=0).encounters
        assert [(begin, end) for begin, end, *_ in encounters_of(store)] == [(n * S, (n + 3) * S) for n in range(1, 30)]
        assert all(one < other for one, other in pairwise(rows.row.tolist()))


def test_a_piece_grows_by_a_record_that_bridges_two() -> None:
    apart = [Meeting(nodes=(1, 2), begin_ns=begin * S, end_ns=(begin + 2) * S) for begin in (0, 10)]
    bridge = Meeting(nodes=(1, 2), begin_ns=S, end_ns=11 * S)
    with closing(Store(None)) as store:
        store.apply(batches(heard(apart, gateway="north")))
        assert len(encounters_of(store)) == 2
        store.apply(batches(heard([bridge], gateway="south")))
        assert encounters_of(store) == [(0, 12 * S, 1, 2)]


def test_a_page_tells_how_wrong_the_clock_that_was_set_right_may_be() -> None:
    what = meetings(100, seed=11)
    with closing(Store(None)) as store:
        store.apply(batches([*heard(what, gateway="north"), *heard(what, gateway="south", ahead_s=300)]))
        bounds = {clock.source.gateway: clock.bound_ns for clock in store.clocks} if store.delta(after=0) else {}
        page = store.encounters(after=0, limit=1000)
        told = {record.gateway: bound for record, bound in zip(page.records, page.bounds_ns, strict=True)}
        assert told == {"north": 0, "south": bounds["south"]}
        assert bounds["south"] >= FLOOR_NS


def test_a_store_that_cannot_be_read_when_a_second_gateway_comes_is_read_later(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Until then each gateway's encounters count by themselves, and nothing ends."""
    one, other = encounter(1, t_ns=(0, 4 * S), gateway="north"), encounter(1, t_ns=(3 * S, 6 * S), gateway="south")
    again = msgspec.structs.replace(other, offset=2, revision=1)
    with closing(Store(tmp_path / "store")) as store:
        store.apply(batches([one, other, again]))
    disk_is_sick = True

    def load() -> Iterator[LoadedEncounters]:
        if disk_is_sick:
            raise StoreError(path="store", reason="cannot be used: disk I/O error", next_step="look at the disk")
        with closing(sqlite3.connect(tmp_path / "store")) as database:
            yield from load_encounters(database, kind=Kind.ENCOUNTER)

    site = SiteView(load)
    site.take_encounters([1], [one], changes=np.array([1]))
    for change, record in ((2, other), (3, again)):
        site.take_encounters([2], [record], changes=np.array([change]))
        assert (site.encounters.n_counting, site.is_joining) == (2, False)
    assert [record.getMessage() for record in caplog.records] == ["site.unjoined"], "said once"
    disk_is_sick = False
    site.settle(change=4)
    assert (site.encounters.n_counting, site.is_joining) == (1, True)
    assert site.members(2) == (1, 2)
