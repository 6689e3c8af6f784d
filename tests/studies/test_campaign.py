"""The campaign of faults: its schedule leaves no doubt, its account bites, and a short one is sound."""

import json
import subprocess
import sys
from collections import defaultdict
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.contract.records import Cause, EncounterRecord, EncounterSide, Mode, ModeRecord, RecordBatch
from firmware_protocol.messages import WireCause, WireMode
from firmware_protocol.units import NS_PER_MS, NS_PER_S, BootId, Nanoseconds, NodeId, RssiDbm
from mapper.store import Store
from studies.campaign.accounting import Account, settle
from studies.campaign.ledger import ROW, Ledger, Row, read_ledger
from studies.campaign.meetings import QUICK_PACE, Meetings, Pace, count_biobots
from studies.campaign.plan import Kind, Unit, draw_faults

_COUNTS = {Unit.LINE: 8, Unit.GATEWAY: 2, Unit.MAPPER: 1, Unit.ROUTER: 1}
_T0_NS = 1_000 * NS_PER_S


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), rate=st.floats(3.0, 12.0), pace=st.sampled_from([Pace(), QUICK_PACE]))
def test_two_meetings_of_a_pair_are_far_apart_and_two_sides_of_one_overlap(seed: int, rate: float, pace: Pace) -> None:
    meetings = Meetings(seed=seed, n_biobots=count_biobots(rate), rate=rate, pace=pace)
    spans: dict[tuple[int, int], list[tuple[float, float]]] = defaultdict(list)
    for _, sides in meetings.due(0, until_s=150.0):
        for side in sides:
            assert side.start_s < side.end_s
            spans[min(side.node, side.peer), max(side.node, side.peer)].append((side.start_s, side.end_s))
    assert spans
    for times in spans.values():
        times.sort()
        for (start_s, end_s), (next_s, _) in pairwise(times):
            is_other_side = next_s - start_s < 1.0
            assert (min(end_s, start_s + pace.longest_s) - next_s > 2.0) if is_other_side else next_s - end_s > 4.0


@given(seed=st.integers(0, 2**32 - 1))
def test_a_plan_is_a_function_of_its_seed_and_has_every_kind(seed: int) -> None:
    kinds = [kind for kind in Kind if kind is not Kind.KILL_ROUTER]
    plan = draw_faults(seed, n_faults=60, span_s=100.0, kinds=kinds, counts=_COUNTS, mapper_from_s=50.0)
    assert plan == draw_faults(seed, n_faults=60, span_s=100.0, kinds=kinds, counts=_COUNTS, mapper_from_s=50.0)
    assert {fault.kind for fault in plan} == set(kinds)
    assert all(3.0 <= fault.at_s <= 97.0 and 0 <= fault.index < _COUNTS[fault.unit] for fault in plan)
    assert all(fault.at_s >= 50.0 for fault in plan if fault.unit is Unit.MAPPER)


def test_a_ledger_that_was_cut_anywhere_gives_its_whole_rows(tmp_path: Path) -> None:
    rows = [_told(node=1, peer=2, at_s=float(at)) for at in range(3)]
    with Ledger(tmp_path / "ledger") as ledger:
        for row in rows:
            ledger.add(row)
    whole = (tmp_path / "ledger").read_bytes()
    for length in range(len(whole) + 1):
        (tmp_path / "cut").write_bytes(whole[:length])
        assert read_ledger(tmp_path / "cut").tolist() == rows[: length // ROW.itemsize]


def _told(*, node: int, peer: int, at_s: float, lasts_s: float = 5.0, is_ongoing: bool = False) -> Row:
    start_ns = _T0_NS + round(at_s * NS_PER_S)
    lasts_ms = round(lasts_s * 1000)
    return (0, node, 1, 0, peer, -60 - node, int(is_ongoing), round(at_s * 1000), lasts_ms, start_ns, start_ns + lasts_ms * NS_PER_MS)


def _told_mode(*, node: int, at_s: float) -> Row:
    start_ns = _T0_NS + round(at_s * NS_PER_S)
    return (1, node, 1, 0, WireMode.CRW.value, 0, WireCause.NATURAL.value, round(at_s * 1000), 0, start_ns, start_ns)


def _head(offset: int) -> dict[str, Any]:
    return {
        "gateway": "g1", "journal": "j", "offset": offset, "boot": BootId(1), "sequence": offset, "revision": 0,
        "wall_anchor_ns": Nanoseconds(0),
    }  # fmt: skip


def _record(offset: int, *nodes: int, at_s: float, lasts_s: float = 5.0, rssi_off: int = 0, is_void: bool = False) -> EncounterRecord:
    start_ns = Nanoseconds(_T0_NS + round(at_s * NS_PER_S))
    end_ns = Nanoseconds(start_ns + round(lasts_s * NS_PER_S))
    sides = tuple(
        EncounterSide(node=NodeId(node), t_start_ns=start_ns, t_end_ns=end_ns, rssi_dbm=RssiDbm(-60 - node + rssi_off)) for node in nodes
    )
    return EncounterRecord(
        **_head(offset), node_a=NodeId(1), node_b=NodeId(2), t_start_ns=start_ns, t_end_ns=end_ns, error_ns=Nanoseconds(10 * NS_PER_MS),
        is_reciprocal=len(nodes) == 2, is_ongoing=False, is_void=is_void, sides=sides,
    )  # fmt: skip


def _mode_record(offset: int, *, node: int, at_s: float) -> ModeRecord:
    start_ns = Nanoseconds(_T0_NS + round(at_s * NS_PER_S))
    return ModeRecord(
        **_head(offset), node=NodeId(node), mode=Mode.CRW, cause=Cause.NATURAL, t_start_ns=start_ns, t_end_ns=None,
        error_ns=Nanoseconds(10 * NS_PER_MS),
    )  # fmt: skip


def _settle(tmp_path: Path, rows: list[Row], *records: EncounterRecord | ModeRecord) -> Account:
    with closing(Store(tmp_path / "store")) as store:
        store.apply([RecordBatch(gateway="g1", journal="j", head_offset=len(records), records=records)])
    return settle({"g1": np.array(rows, dtype=ROW)}, tmp_path / "store")


_BOTH = [
    _told(node=1, peer=2, at_s=10.0, lasts_s=2.0, is_ongoing=True),
    _told(node=1, peer=2, at_s=10.0),
    _told(node=2, peer=1, at_s=10.0),
    _told(node=1, peer=2, at_s=30.0),
    _told_mode(node=1, at_s=3.0),
]
_KEPT = (_record(1, 1, 2, at_s=10.0), _record(2, 1, at_s=30.0), _mode_record(3, node=1, at_s=3.0))


def test_an_account_of_what_was_kept_as_it_was_told_is_sound(tmp_path: Path) -> None:
    account = _settle(tmp_path, _BOTH, *_KEPT, _record(4, 1, at_s=12.0, is_void=True))
    assert account.examples == []
    assert account.is_sound
    assert (account.n_entries, account.n_ongoing, account.n_encounters, account.n_reciprocal) == (4, 1, 2, 1)
    assert (account.n_records, account.n_void, account.n_modes) == (2, 1, 1)


@pytest.mark.parametrize(
    ("records", "fault"),
    [
        ((_KEPT[0], _KEPT[2]), "n_lost"),
        ((*_KEPT, _record(4, 2, at_s=11.0)), "n_duplicated"),
        ((*_KEPT, _record(4, 2, at_s=50.0)), "n_unreported"),
        ((_record(1, 1, at_s=10.0), *_KEPT[1:]), "n_altered"),
        ((_record(1, 1, 2, at_s=10.0, rssi_off=1), *_KEPT[1:]), "n_altered"),
        ((_record(1, 1, 2, at_s=10.0, lasts_s=5.02), *_KEPT[1:]), "n_altered"),
        ((_KEPT[0], _record(2, 1, at_s=30.004, lasts_s=4.995), _KEPT[2]), "n_altered"),
        (_KEPT[:2], "n_modes_lost"),
        ((*_KEPT, _mode_record(4, node=1, at_s=8.0)), "n_modes_unreported"),
        ((*_KEPT, _mode_record(4, node=1, at_s=3.005)), "n_modes_duplicated"),
    ],
    ids=["lost", "duplicated", "unreported", "side lost", "RSSI", "time", "duration", "mode lost", "mode unreported", "mode duplicated"],
)
def test_an_account_sees_what_is_wrong(tmp_path: Path, records: tuple[EncounterRecord | ModeRecord, ...], fault: str) -> None:
    account = _settle(tmp_path, _BOTH, *records)
    assert getattr(account, fault) == 1
    assert not account.is_sound
    assert account.examples


@pytest.mark.campaign
def test_a_short_campaign_is_sound(tmp_path: Path) -> None:
    """Real processes, every dialect, every kind of fault that this machine allows."""
    out = tmp_path / "out"
    command = [sys.executable, "-m", "studies.campaign", "--quick", "--encounters", "150", "--faults", "21", "--rate", "30"]
    done = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    facts = json.loads((out / "round1" / "facts.json").read_text())
    assert facts["account"]["n_encounters"] >= 150
    assert len(facts["outcomes"]) == 21
    assert not any(is_late for _, _, is_late, _ in facts["outcomes"])
    again = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True, timeout=60, check=False)
    assert again.stdout == done.stdout, "a round that is done is not done again"
