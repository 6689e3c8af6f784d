"""The link: two real ends over a lossy wire, no sockets, no sleeps."""

from collections import deque
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.errors import LinkFullError
from firmware_protocol.link import (
    MAX_PAYLOAD,
    Link,
    LinkConfig,
    LinkEvent,
    LinkLost,
    LinkOpened,
    LinkState,
    LostReason,
    PayloadConfirmed,
    PayloadReceived,
    Role,
)

MS = 1_000_000
PATIENT = LinkConfig(max_silent_retries=10_000, max_fruitless_retries=10_000)


@dataclass
class Wire:
    """Two ends joined by a wire that loses the frames it is told to lose; time passes in steps of 50 ms."""

    base: Link = field(default_factory=lambda: Link(role=Role.INITIATOR))
    dongle: Link = field(default_factory=lambda: Link(role=Role.RESPONDER))
    losses: list[bool] = field(default_factory=list)
    now_ns: int = 0
    at_base: list[bytes] = field(default_factory=list)
    at_dongle: list[bytes] = field(default_factory=list)
    events: list[LinkEvent] = field(default_factory=list)
    confirms: bool = True

    def run(self, steps: int = 1) -> None:
        for _ in range(steps):
            self.now_ns += 50 * MS
            for link in (self.base, self.dongle):
                deadline = link.next_deadline_ns()
                if deadline is not None and deadline <= self.now_ns:
                    self.note(link, link.handle_deadline(now_ns=self.now_ns))
            for _ in range(4):
                self.carry(self.base, self.dongle)
                self.carry(self.dongle, self.base)

    def carry(self, sender: Link, receiver: Link) -> None:
        for frame in sender.take_frames():
            if not (self.losses and self.losses.pop(0)):
                self.note(receiver, receiver.receive(frame, now_ns=self.now_ns))

    def note(self, link: Link, events: list[LinkEvent]) -> None:
        self.events += events
        for event in events:
            if isinstance(event, PayloadReceived):
                (self.at_base if link is self.base else self.at_dongle).append(event.payload)
                if self.confirms:
                    link.confirm(event.receipt)


def opened(**kwargs: object) -> Wire:
    wire = Wire(**kwargs)  # type: ignore[arg-type]  # forwarded
    wire.base.open(session=1, now_ns=0)
    wire.run(2)
    return wire


def test_a_session_opens() -> None:
    wire = opened()

    assert wire.base.state is wire.dongle.state is LinkState.OPEN
    assert [type(event) for event in wire.events] == [LinkOpened, LinkOpened]


@given(st.lists(st.booleans(), max_size=300), st.integers(0, 40), st.integers(0, 40))
def test_everything_arrives_once_and_in_order_whatever_is_lost(losses: list[bool], n_up: int, n_down: int) -> None:
    """Losses end some time, as a cable that never works delivers nothing; then all must have come through."""
    wire = Wire(base=Link(role=Role.INITIATOR, config=PATIENT), losses=losses)
    wire.dongle.config = PATIENT
    wire.base.open(session=7, now_ns=0)
    up = [b"u%d" % i for i in range(n_up)]
    down = [b"d%d" % i for i in range(n_down)]
    for payload in up:
        wire.dongle.send(payload, now_ns=0)
    for payload in down:
        wire.base.send(payload, now_ns=0)

    wire.run(2_000)

    assert wire.at_base == up
    assert wire.at_dongle == down
    assert sum(isinstance(event, PayloadConfirmed) for event in wire.events) == n_up + n_down


def test_more_than_256_payloads_keep_their_order() -> None:
    wire = opened()
    sent = [i.to_bytes(2, "big") for i in range(700)]
    for start in range(0, 700, 100):
        for payload in sent[start : start + 100]:
            wire.dongle.send(payload, now_ns=wire.now_ns)
        wire.run(10)

    assert wire.at_base == sent


def test_an_unconfirmed_payload_is_not_acknowledged_and_stalls_but_does_not_break_the_link() -> None:
    wire = opened(confirms=False)
    tickets = [wire.dongle.send(b"%d" % i, now_ns=wire.now_ns) for i in range(20)]

    wire.run(400)

    assert len(wire.at_base) == wire.dongle.config.window
    assert wire.dongle.state is wire.base.state is LinkState.OPEN
    assert not any(isinstance(event, PayloadConfirmed) for event in wire.events)
    received = [event for event in wire.events if isinstance(event, PayloadReceived)]
    wire.confirms = True
    wire.base.confirm(received[-1].receipt)
    wire.run(50)
    assert [event.ticket for event in wire.events if isinstance(event, PayloadConfirmed)] == tickets


def test_what_the_dongle_heard_survives_a_new_session() -> None:
    wire = opened(confirms=False)
    wire.dongle.send(b"heard", now_ns=wire.now_ns)
    wire.run(2)
    wire.base = Link(role=Role.INITIATOR)
    wire.base.open(session=2, now_ns=wire.now_ns)

    wire.run(5)

    assert wire.at_base == [b"heard", b"heard"]


def test_what_the_base_has_not_seen_confirmed_is_dropped_and_reported() -> None:
    wire = opened(losses=[])
    wire.losses = [True] * 1000
    ticket = wire.base.send(b"stimulate", now_ns=wire.now_ns)

    wire.run(400)

    lost = [event for event in wire.events if isinstance(event, LinkLost) and event.dropped]
    assert lost == [LinkLost(reason=LostReason.NO_ANSWER, dropped=(ticket,))]
    wire.losses = []
    wire.base.open(session=2, now_ns=wire.now_ns)
    wire.run(5)
    assert wire.at_dongle == []


def test_an_urgent_payload_overtakes_all_that_has_not_been_sent() -> None:
    wire = opened()
    for i in range(40):
        wire.base.send(b"%d" % i, now_ns=wire.now_ns)
    wire.base.send(b"STOP", now_ns=wire.now_ns, is_urgent=True)

    wire.run(40)

    assert wire.at_dongle.index(b"STOP") == wire.base.config.window


def test_an_urgent_payload_does_not_wait_for_a_window_that_is_less_than_the_links() -> None:
    link = Link(role=Role.INITIATOR, config=LinkConfig(window=4))
    link.open(session=1, now_ns=0)
    link.receive(b"\x02\x01\x00\x00\x01", now_ns=0)
    for i in range(40):
        link.send(b"%d" % i, now_ns=0)
    for _ in range(20):
        link.send(b"STOP", now_ns=0, is_urgent=True)

    payloads = [frame[4:] for frame in link.take_frames() if frame[0] == 3]
    assert payloads == [*[b"STOP"] * 12, b"0", b"1", b"2", b"3"], "nothing had been handed out when the first of them came"


def test_an_urgent_payload_goes_before_all_that_was_not_handed_out_and_behind_earlier_urgent_ones() -> None:
    link = Link(role=Role.INITIATOR, config=LinkConfig(window=4))
    link.open(session=1, now_ns=0)
    link.receive(b"\x02\x01\x00\x00\x01", now_ns=0)
    link.take_frames()
    for i in range(40):
        link.send(b"%d" % i, now_ns=0)
    first = link.take_frames(at_most=3)
    for i in range(3):
        link.send(b"STOP %d" % i, now_ns=0, is_urgent=True)

    frames = [*first, *link.take_frames()]
    assert [frame[4:] for frame in frames] == [b"0", b"1", b"2", b"STOP 0", b"STOP 1", b"STOP 2", b"3"]
    assert [frame[3] for frame in frames] == [0, 1, 2, 3, 4, 5, 6], "numbers are given in the order of the line"


@given(data=st.data())
def test_what_is_taken_back_never_goes_out_and_all_else_does_once_in_order(data: st.DataObject) -> None:
    """Whatever is sent, urgent or not, taken back, handed out one by one and acknowledged: the peer hears the rest, each once."""
    wire = opened()
    sent: dict[int, bytes] = {}
    taken_back: set[bytes] = set()
    for i in range(data.draw(st.integers(1, 60))):
        match data.draw(st.sampled_from(("send", "urgent", "cancel", "take", "run"))):
            case "cancel" if sent:
                ticket = data.draw(st.sampled_from(sorted(sent)))
                if wire.base.cancel(ticket):
                    taken_back.add(sent[ticket])
            case "take":
                wire.base.take_frames(at_most=1)  # and lost
            case "run":
                wire.run(1)
            case kind:
                payload = b"%d" % i
                sent[wire.base.send(payload, now_ns=wire.now_ns, is_urgent=kind == "urgent")] = payload
    wire.run(200)

    assert sorted(wire.at_dongle) == sorted(set(sent.values()) - taken_back)


def test_a_payload_is_taken_back_as_long_as_it_was_not_sent() -> None:
    wire = opened()
    tickets = [wire.base.send(b"%d" % i, now_ns=wire.now_ns) for i in range(20)]

    lost = wire.base.take_frames(at_most=3)
    assert [wire.base.cancel(tickets[at]) for at in (0, 2, 3, 16, 19, 19)] == [False, False, True, True, True, False]
    wire.run(10)

    assert len(lost) == 3
    assert wire.at_dongle == [b"%d" % i for i in range(20) if i not in {3, 16, 19}]


@dataclass
class SlowLine:
    """Two open ends and a line that keeps frames in their order until they are carried; no time passes. It loses those whose turn it is."""

    ends: tuple[Link, Link]
    lost: set[int]
    n_carried: int = 0
    on_line: tuple[deque[bytes], deque[bytes]] = field(default_factory=lambda: (deque(), deque()))
    unconfirmed: tuple[deque[int], deque[int]] = field(default_factory=lambda: (deque(), deque()))
    received: tuple[list[bytes], list[bytes]] = field(default_factory=lambda: ([], []))

    def carry(self, end: int) -> None:
        """Put on the line what an end says, and carry the oldest frame to the other end."""
        self.on_line[end].extend(self.ends[end].take_frames())
        if self.on_line[end]:
            frame = self.on_line[end].popleft()
            self.n_carried += 1
            if self.n_carried not in self.lost:
                self.hear(1 - end, frame)

    def hear(self, end: int, frame: bytes) -> None:
        for event in self.ends[end].receive(frame, now_ns=0):
            if isinstance(event, PayloadReceived):
                self.received[end].append(event.payload)
                self.unconfirmed[end].append(event.receipt)

    def confirm(self, end: int) -> None:
        """Let an owner say that the oldest payload it has not confirmed is safe."""
        if self.unconfirmed[end]:
            self.ends[end].confirm(self.unconfirmed[end].popleft())


@given(
    st.integers(0, 40),
    st.integers(0, 40),
    st.lists(st.integers(0, 3), max_size=400),
    st.sets(st.integers(1, 60), max_size=4),
)
def test_a_loss_is_made_good_without_a_timer_and_brings_about_no_more_than_a_window(
    n_up: int, n_down: int, order: list[int], lost: set[int]
) -> None:
    """However slow line and owners are, and in whatever order they do their part. The last frame's loss alone needs the timer."""
    wire = opened()
    line = SlowLine((wire.base, wire.dongle), lost)
    for number in range(n_down):
        wire.base.send(b"%d" % number, now_ns=0)
    for number in range(n_up):
        wire.dongle.send(b"%d" % number, now_ns=0)

    for what in [*order, *[0, 1, 2, 3] * 600]:
        (line.carry if what < 2 else line.confirm)(what % 2)

    for end, n_sent in ((0, n_up), (1, n_down)):
        assert line.received[end] == [b"%d" % number for number in range(len(line.received[end]))]
        assert lost or len(line.received[end]) == n_sent
        assert line.ends[1 - end].outgoing.n_repeated <= len(lost) * wire.base.config.window


@pytest.mark.parametrize("missing", [1, 2, 9])
def test_what_is_missing_is_repeated_before_its_time(missing: int) -> None:
    wire = opened()
    line = SlowLine((wire.base, wire.dongle), {missing})
    for number in range(10):
        wire.base.send(b"%d" % number, now_ns=0)

    for what in [0, 1, 3] * 100:
        (line.carry if what < 2 else line.confirm)(what % 2)

    assert line.received[1] == [b"%d" % number for number in range(10)]


def test_a_dongle_that_talks_but_acknowledges_nothing_is_given_up_within_the_stated_time() -> None:
    """Ten repetitions, 0.3, 0.6 and 1.2 s and then 2 s apart, and 2 s after the last."""
    wire = opened()
    ticket = wire.base.send(b"STOP", now_ns=wire.now_ns)
    wire.base.take_frames()
    wire.dongle = Link(role=Role.RESPONDER)
    while wire.base.state is LinkState.OPEN and wire.now_ns < 60_000 * MS:
        wire.now_ns += 50 * MS
        wire.events += wire.base.receive(b"\x05\x01\x00\x00", now_ns=wire.now_ns)
        wire.events += wire.base.handle_deadline(now_ns=wire.now_ns)
        wire.base.take_frames()

    assert wire.events[-1] == LinkLost(reason=LostReason.NO_PROGRESS, dropped=(ticket,))
    assert wire.now_ns <= 18_400 * MS


def test_a_base_station_that_stalls_itself_does_not_give_its_dongle_up() -> None:
    """A dongle whose queue is full of what the base station has not confirmed cannot take a payload that it would have to answer."""
    wire = opened(confirms=False)
    wire.dongle.send(b"heard", now_ns=wire.now_ns)
    wire.run(2)
    wire.base.send(b"STOP", now_ns=wire.now_ns)

    for _ in range(6_000):
        wire.now_ns += 50 * MS
        wire.base.receive(b"\x05\x01\x00\x00", now_ns=wire.now_ns)
        assert wire.base.handle_deadline(now_ns=wire.now_ns) == []
        wire.base.take_frames()


def test_a_restarted_dongle_is_noticed_at_once_when_it_announces_itself() -> None:
    wire = opened()
    wire.dongle = Link(role=Role.RESPONDER)
    wire.dongle.announce_restart()

    wire.run(1)

    assert wire.events[-1] == LinkLost(reason=LostReason.PEER_RESTARTED)
    assert wire.base.state is LinkState.CLOSED


def test_a_restarted_dongle_is_noticed_by_the_next_ping_when_it_does_not() -> None:
    wire = opened()
    wire.dongle = Link(role=Role.RESPONDER)

    wire.run(70)

    assert wire.events[-1] == LinkLost(reason=LostReason.PEER_RESTARTED)


def test_a_silent_line_is_given_up_within_the_stated_time() -> None:
    """3 s of silence, then 5 pings 0.3 s apart: lost after 4.8 s at the latest."""
    wire = opened()
    wire.losses = [True] * 10_000

    wire.run(round(4.9 / 0.05))

    assert LinkLost(reason=LostReason.NO_ANSWER) in wire.events


def test_an_idle_link_stays_open() -> None:
    wire = opened()

    wire.run(2_000)

    assert wire.base.state is wire.dongle.state is LinkState.OPEN


def test_a_full_queue_is_refused_but_an_urgent_payload_is_taken() -> None:
    link = Link(role=Role.INITIATOR, config=LinkConfig(max_queue=2))
    link.send(b"1", now_ns=0)
    link.send(b"2", now_ns=0)

    with pytest.raises(LinkFullError, match="2"):
        link.send(b"3", now_ns=0)
    assert link.send(b"STOP", now_ns=0, is_urgent=True) == 3


def test_a_payload_too_long_for_a_frame_is_refused() -> None:
    with pytest.raises(ValueError, match=str(MAX_PAYLOAD)):
        Link(role=Role.INITIATOR).send(bytes(MAX_PAYLOAD + 1), now_ns=0)


def test_opening_anew_reports_what_was_under_way() -> None:
    wire = opened()
    ticket = wire.base.send(b"x", now_ns=wire.now_ns)

    events = wire.base.open(session=2, now_ns=wire.now_ns)

    assert events == [LinkLost(reason=LostReason.PEER_RESET, dropped=(ticket,))]


@pytest.mark.parametrize(("offered", "chosen"), [(b"", 1), (b"\x01", 1), (b"\x02", 1), (b"\xff\x07", 1)])
def test_a_responder_answers_a_newer_base_station_with_what_both_speak(offered: bytes, chosen: int) -> None:
    dongle = Link(role=Role.RESPONDER)

    assert dongle.receive(b"\x01\x05\x00\x00" + offered, now_ns=0) == [LinkOpened()]
    assert dongle.take_frames() == [b"\x02\x05\x00\x00" + bytes([chosen])]
    assert dongle.version == chosen
    dongle.receive(b"\x01\x05\x00\x00" + offered, now_ns=0)
    assert dongle.take_frames() == [b"\x02\x05\x00\x00" + bytes([chosen])]


def test_a_reset_of_link_version_0_is_ignored() -> None:
    dongle = Link(role=Role.RESPONDER)

    assert dongle.receive(b"\x01\x01\x00\x00\x00", now_ns=0) == []
    assert dongle.state is LinkState.CLOSED
    assert dongle.n_ignored == 1


@pytest.mark.parametrize("payload", [b"", b"\x01"])
def test_a_base_station_takes_the_version_that_was_chosen(payload: bytes) -> None:
    base = Link(role=Role.INITIATOR)
    base.open(session=5, now_ns=0)

    assert base.take_frames() == [b"\x01\x05\x00\x00\x01"]
    assert base.receive(b"\x02\x05\x00\x00" + payload, now_ns=0) == [LinkOpened()]
    assert base.version == 1


@pytest.mark.parametrize("version", [0, 2])
def test_a_base_station_ignores_a_version_that_it_did_not_offer(version: int) -> None:
    base = Link(role=Role.INITIATOR)
    base.open(session=5, now_ns=0)

    assert base.receive(bytes([2, 5, 0, 0, version]), now_ns=0) == []
    assert base.state is LinkState.OPENING
    assert base.n_ignored == 1


@given(st.sampled_from(Role), st.booleans(), st.lists(st.binary(max_size=12), max_size=30), st.lists(st.integers(0, 5), max_size=30))
def test_from_any_state_any_frame_leads_to_a_known_state(role: Role, is_open: bool, frames: list[bytes], kinds: list[int]) -> None:
    wire = opened() if is_open else Wire()
    link = wire.base if role is Role.INITIATOR else wire.dongle
    for frame, kind in zip(frames, kinds, strict=False):
        for body in (frame, bytes([kind + 1, 1, 0]) + frame):
            link.receive(body, now_ns=wire.now_ns)
            wire.now_ns += 100 * MS
            link.handle_deadline(now_ns=wire.now_ns)
        assert link.state in LinkState
        assert all(len(out) <= MAX_PAYLOAD + 4 for out in link.take_frames())
