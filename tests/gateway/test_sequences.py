"""Laws of the window of a backpack's message numbers."""

from hypothesis import given
from hypothesis import strategies as st

from gateway.sequences import ACKNOWLEDGE_SPAN, SequenceWindow


def _says(window: SequenceWindow, number: int) -> bool:
    """Whether the acknowledgement covers ``number``, read as a backpack reads it (WIRE_FORMAT.md §6.3)."""
    next_sequence, bitmap = window.acknowledgement()
    ahead = (number - next_sequence) % 65536
    return ahead >= 32768 or (1 <= ahead <= 32 and bool(bitmap >> (ahead - 1) & 1))


@given(st.permutations(range(ACKNOWLEDGE_SPAN + 1)), st.integers(0, ACKNOWLEDGE_SPAN))
def test_exactly_what_came_is_acknowledged_in_any_order(order: list[int], n_come: int) -> None:
    window = SequenceWindow()
    for number in order[:n_come]:
        assert not window.has(number)
        window.add(number)
        assert window.has(number)
    assert {number for number in order if _says(window, number)} == set(order[:n_come])
    assert window.n_skipped == 0


@given(st.integers(0, 65535), st.data())
def test_a_backpack_that_keeps_to_its_window_gets_all_numbers_acknowledged_across_the_wrap(start: int, data: st.DataObject) -> None:
    window = SequenceWindow(next=start, is_fresh=False)
    outstanding = list(range(start, start + ACKNOWLEDGE_SPAN + 1))
    for _ in range(80):
        number = data.draw(st.sampled_from(outstanding))
        assert window.unwrap(number % 65536) == number
        window.add(number)
        assert _says(window, number)
        outstanding = [one for one in outstanding if not _says(window, one)]
        oldest = min(outstanding, default=window.next)
        outstanding = sorted({*outstanding, *(one for one in range(oldest, oldest + 33) if not window.has(one))})
    assert window.n_skipped == 0


@given(st.integers(0, 65535))
def test_a_journal_that_begins_in_the_middle_acknowledges_what_it_hears(first: int) -> None:
    window = SequenceWindow()
    number = window.unwrap(first)
    window.add(number)
    assert _says(window, first)
    assert not any(_says(window, one % 65536) for one in range(first + 1, first + 34))


def test_a_repeated_number_is_known_and_changes_nothing() -> None:
    window = SequenceWindow()
    for number in (0, 1, 3):
        window.add(number)
    before = window.acknowledgement()
    window.add(1)
    window.add(3)
    assert window.acknowledgement() == before
    assert [number for number in range(33) if _says(window, number)] == [0, 1, 3]


def test_a_window_that_begins_just_after_the_wrap_takes_what_was_sent_before_it() -> None:
    window = SequenceWindow()
    for sequence in (2, 3, 65533, 65534, 65535, 0, 1):
        number = window.unwrap(sequence)
        assert not window.has(number)
        window.add(number)
        assert _says(window, sequence)
    assert window.n_skipped == 0
