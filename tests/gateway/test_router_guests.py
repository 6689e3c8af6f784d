"""Laws of whom a router tells of: who stays, once, and that they left; strangers once; who comes for a moment, never."""

from hypothesis import given
from hypothesis import strategies as st

from gateway.router_guests import STAYS_S, Guest, GuestBook

GUESTS = [Guest(name=f"demo/operator/{letter}", address=f"tls/192.0.2.1:{n}", zid=letter) for n, letter in enumerate("abc")]


@given(st.lists(st.tuples(st.sampled_from(GUESTS), st.floats(0.0, 2 * STAYS_S)), max_size=40))
def test_what_is_told_alternates_and_is_told_of_those_who_stay_alone(steps: list[tuple[Guest, float]]) -> None:
    """A step is somebody who comes, or leaves where they are there, and the time until the next one."""
    book, now_s = GuestBook(), 0.0
    came: dict[Guest, float] = {}
    told: set[Guest] = set()
    for guest, pause_s in steps:
        if guest in came:
            assert book.leave(guest) == (guest in told)
            del came[guest]
            told.discard(guest)
        else:
            book.come(guest, now_s=now_s)
            came[guest] = now_s
        due_s = book.next_s()
        assert (due_s is None) == (came.keys() <= told)
        now_s += pause_s
        stayed = book.stayed(now_s=now_s)
        assert not told.intersection(stayed)
        told.update(stayed)
        assert told == {one for one, since_s in came.items() if since_s + STAYS_S <= now_s}


def test_a_stranger_is_told_of_once_until_it_has_been_away_for_a_while() -> None:
    book = GuestBook()
    told = [book.come_stranger("demo/gateway/base1", now_s=n * 3.0) for n in range(100)]
    assert told == [True] + [False] * 99
    assert book.come_stranger("demo/gateway/base2", now_s=300.0), "whose name differs in a number is another one"
    assert book.come_stranger("demo/gateway/base1", now_s=400.0)
    assert not any(book.come_stranger(f"demo/viewer/{n}", now_s=500.0) is False for n in range(1000)), "many are no trouble"
    book.forget()
    assert book.come_stranger("demo/gateway/base1", now_s=400.0), "the roster was read again"
