"""Laws of being heard through a router: who was heard joins anew at once, who never was is told so once and tries more and more rarely."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.hearing import WHY, Hearing, Told


def look_until_it_joins_anew(hearing: Hearing, *, heard_first: bool) -> tuple[float, list[Told]]:
    """Return how long a session lasted [s], and what was told, where nobody hears it (any more)."""
    hearing.begin()
    lasted_s, told = 0.0, []
    for n in range(100):
        lasted_s += hearing.pause_s()
        if (one := hearing.look(is_heard=heard_first and n == 0)) is not None:
            told.append(one)
        if hearing.joins_anew:
            return lasted_s, told
    raise AssertionError("it stays, though nobody hears it")


def test_one_that_was_heard_joins_anew_within_seconds_however_often_it_happens() -> None:
    hearing = Hearing()
    for _ in range(20):
        lasted_s, told = look_until_it_joins_anew(hearing, heard_first=True)
        assert lasted_s <= 30.0
        assert told == [Told.UNHEARD]


def test_one_that_is_denied_is_told_so_once_and_joins_ever_more_rarely() -> None:
    hearing = Hearing()
    lasted, told = zip(*(look_until_it_joins_anew(hearing, heard_first=False) for _ in range(20)), strict=True)
    assert list(told[:2]) == [[Told.UNHEARD], [Told.DENIED]]
    assert not any(told[2:])
    assert "roster" in WHY[Told.DENIED]
    assert all(before <= after for before, after in itertools.pairwise(lasted))
    assert 55.0 < lasted[-1] < 70.0
    hearing.begin()
    hearing.link()
    assert hearing.pause_s() < 5.0, "a new link is looked at soon: the router may have read its roster again"
    assert hearing.look(is_heard=True) is Told.HEARD
    assert hearing.look(is_heard=True) is None
    assert look_until_it_joins_anew(hearing, heard_first=False)[1] == [Told.UNHEARD], "and then all is as at first"


@given(st.lists(st.sampled_from([True, None]), max_size=30), st.lists(st.sampled_from([True, False, None]), max_size=60))
def test_nobody_leaves_a_session_but_for_looks_in_a_row_that_found_it_unheard(well: list[bool | None], any_way: list[bool | None]) -> None:
    hearing = Hearing()
    hearing.begin()
    for one in well:
        assert hearing.pause_s() > 0.0
        assert hearing.look(is_heard=one) is None
        assert not hearing.joins_anew
    in_a_row = 0
    for one in any_way:
        in_a_row = in_a_row + 1 if one is False else 0
        hearing.look(is_heard=one)
        assert hearing.joins_anew == (in_a_row >= 3)
        if hearing.joins_anew:
            hearing.begin()
            in_a_row = 0
