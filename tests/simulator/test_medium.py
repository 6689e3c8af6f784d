"""Laws of the shared channel."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.radios.beacons import BEACON_OCTETS
from simulator.radios.medium import Medium, Sending, airtime_ns, find_overlaps

MS = 1_000_000


def test_a_packet_of_127_octets_takes_4_256_ms_and_150_beacons_a_second_fill_16_percent() -> None:
    assert airtime_ns(127) == 4_256_000
    assert airtime_ns(BEACON_OCTETS) == 1_056_000
    assert 150 * airtime_ns(BEACON_OCTETS) / 1e9 == pytest.approx(0.158, abs=0.001)


def send(medium: Medium, *, n: int, rate_hz: float, seconds: float, seed: int = 1) -> list[Sending]:
    rng = np.random.default_rng(seed)
    for at_s in np.sort(rng.uniform(0, seconds, int(n * rate_hz * seconds))):
        medium.request(int(rng.integers(1, n + 1)), at_ns=int(at_s * 1e9), n_octets=BEACON_OCTETS)
    return medium.run_until(1 << 60)


def overlapping(sendings: list[Sending]) -> int:
    """How many packets overlap another one."""
    sent = sorted((one for one in sendings if one.is_sent), key=lambda one: one.start_ns)
    start, end = (np.array([getattr(one, name) for one in sent]) for name in ("start_ns", "end_ns"))
    return np.unique(find_overlaps(start, end, subject=np.arange(len(sent)))[0]).size


def test_those_that_cannot_hear_each_other_collide_as_often_as_their_airtimes_overlap() -> None:
    """Poisson senders that never wait: a packet is clean if no other starts within one airtime before or after, exp(-2 G)."""
    load = 150 * airtime_ns(BEACON_OCTETS) / 1e9
    sendings = send(Medium(seed=1, hears=lambda _listener, _talker, _t: False), n=150, rate_hz=1.0, seconds=100.0)
    share = overlapping(sendings) / len(sendings)
    assert all(one.is_sent for one in sendings)
    # The same sender's own packets do wait for each other, 1 in 150.
    assert share == pytest.approx(1 - math.exp(-2 * load), rel=0.05)


def test_two_hidden_nodes_collide_with_the_probability_that_their_airtimes_overlap() -> None:
    """Of 64 pairs of draws, those that differ by at most 3 backoff periods collide, as 1056 us < 4 * 320: 8 + 2 (7 + 6 + 5) = 44."""
    medium = Medium(seed=2, hears=lambda _listener, _talker, _t: False)
    n = 4000
    for k in range(n):
        for sender in (1, 2):
            medium.request(sender, at_ns=k * 100 * MS, n_octets=BEACON_OCTETS)
    collided = overlapping(medium.run_until(1 << 60)) / (2 * n)
    assert collided == pytest.approx(44 / 64, abs=4 * math.sqrt(44 / 64 * 20 / 64 / n))


def test_two_that_hear_each_other_collide_only_while_one_turns_around() -> None:
    """Both begin at once; the later look sees the earlier packet unless both draw the same of 8 periods: 1 of 8 pairs."""
    medium = Medium(seed=3)
    n = 4000
    for k in range(n):
        for sender in (1, 2):
            medium.request(sender, at_ns=k * 100 * MS, n_octets=BEACON_OCTETS)
    sendings = medium.run_until(1 << 60)
    assert overlapping(sendings) / (2 * n) == pytest.approx(1 / 8, abs=4 * math.sqrt(7 / 64 / n))
    assert all(one.is_sent for one in sendings)


def test_an_overloaded_channel_makes_senders_give_up_and_never_carries_more_than_it_holds() -> None:
    sendings = send(Medium(seed=4), n=150, rate_hz=10.0, seconds=5.0)
    sent = [one for one in sendings if one.is_sent]
    span_ns = max(one.end_ns for one in sent) - min(one.start_ns for one in sent)
    busy = sum(one.end_ns - one.start_ns for one in sent) / span_ns
    assert len(sent) < 0.95 * len(sendings)
    assert 0.5 < busy < 1.2


def test_giving_up_takes_five_looks_and_at_most_some_35_ms() -> None:
    medium = Medium(seed=5)
    medium.request(1, at_ns=0, n_octets=4000)
    for sender in range(2, 100):
        medium.request(sender, at_ns=10 * MS, n_octets=BEACON_OCTETS)
    gave_up = [one for one in medium.run_until(1 << 60) if not one.is_sent]
    # Waits of 7, 15 and three times 31 periods of 320 us at most, and five looks of 128 us.
    assert len(gave_up) == 98
    assert max(one.end_ns for one in gave_up) <= 10 * MS + (7 + 15 + 3 * 31) * 320_000 + 5 * 128_000


@given(
    requests=st.lists(st.tuples(st.integers(1, 6), st.integers(0, 30 * MS)), max_size=40),
    cuts=st.lists(st.integers(0, 60 * MS), max_size=6),
)
def test_running_in_pieces_changes_nothing(requests: list[tuple[int, int]], cuts: list[int]) -> None:
    def all_sendings(stops: list[int]) -> list[Sending]:
        medium = Medium(seed=6)
        for sender, at_ns in sorted(requests, key=lambda one: one[1]):
            medium.request(sender, at_ns=at_ns, n_octets=BEACON_OCTETS)
        return [one for stop in stops for one in medium.run_until(stop)]

    assert all_sendings([*sorted(cuts), 1 << 60]) == all_sendings([1 << 60])


@given(requests=st.lists(st.tuples(st.integers(1, 6), st.integers(0, 30 * MS)), max_size=40), stop=st.integers(0, 40 * MS))
def test_what_overlaps_a_packet_is_decided_when_that_has_ended(requests: list[tuple[int, int]], stop: int) -> None:
    medium = Medium(seed=7, hears=lambda listener, talker, _t: (listener + talker) % 2 == 0)
    for sender, at_ns in requests:
        medium.request(sender, at_ns=at_ns, n_octets=BEACON_OCTETS)
    ended = medium.run_until(stop)
    known = {one.ticket for one in [*ended, *medium.under_way()]}
    later = [one for one in medium.run_until(1 << 60) if one.is_sent and one.ticket not in known]
    assert all(other.start_ns >= one.end_ns for one in ended for other in later)


def test_a_channel_that_is_not_shared_lets_everybody_send_at_once() -> None:
    sendings = send(Medium(seed=8, is_shared=False), n=10, rate_hz=100.0, seconds=1.0)
    assert all(one.is_sent and one.end_ns - one.start_ns == airtime_ns(BEACON_OCTETS) for one in sendings)


@given(spans=st.lists(st.tuples(st.integers(0, 100), st.integers(1, 20)), min_size=1, max_size=30))
def test_overlaps_are_those_that_all_pairs_show(spans: list[tuple[int, int]]) -> None:
    start = np.array(sorted(begin for begin, _ in spans))
    end = start + np.array([length for _, length in spans])
    subject, other = find_overlaps(start, end, subject=np.arange(start.size))
    slow = [(a, b) for a in range(start.size) for b in range(start.size) if a != b and start[a] < end[b] and start[b] < end[a]]
    assert list(zip(subject.tolist(), other.tolist(), strict=True)) == slow
