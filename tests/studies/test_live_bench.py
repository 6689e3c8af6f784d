"""The parts of the bench of live operation: a life as records, and the tap that times acknowledgements."""

import socket
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from firmware_protocol.contract.records import Mode
from firmware_protocol.framing.cobs import CobsDecoder, encode_frame
from firmware_protocol.link import Link, LinkState, PayloadReceived, Role
from mapper.store import Store
from studies.link_tap import LinkTap
from studies.live_life import N_BIOBOTS, N_LANDMARKS, Life, fill_store
from studies.live_watch import share

ANCHOR_NS = 1_900_000_000_000_000_000


def test_a_life_fills_a_store_with_every_encounter_and_the_landmarks_modes(tmp_path: Path) -> None:
    life = Life.simulate(12_000, seed=3)
    assert len(life) == 12_000
    assert np.all(np.diff(life.t_end_ns) >= 0)
    assert np.all(life.t_start_ns <= life.t_end_ns)
    assert np.all((life.id1 >= 1) & (life.id1 < life.id2) & (life.id2 <= N_BIOBOTS))
    life.save(tmp_path / "life.npz")
    fill_store(tmp_path / "store.db", Life.load(tmp_path / "life.npz"), n_encounters=7_000, anchor_ns=ANCHOR_NS)
    with closing(Store(tmp_path / "store.db")) as store:
        assert store.n_encounters == 7_000
        assert {record.mode for record in store.latest_modes()} == {Mode.S}
        assert len(store.latest_modes()) == N_LANDMARKS
        (last,) = store.encounters(after=7_000 + N_LANDMARKS - 1, limit=10).records
        assert (last.node_a, last.node_b, last.t_start_ns, last.t_end_ns) == tuple(
            int(column[6_999]) for column in (life.id1, life.id2, life.t_start_ns, life.t_end_ns)
        )


class End:
    """One end of a link on a socket that does not wait long."""

    def __init__(self, role: Role, line: socket.socket) -> None:
        self.link = Link(role=role)
        self._line = line
        self._decoder = CobsDecoder()
        line.settimeout(0.005)

    def turn(self) -> list[PayloadReceived]:
        """Send what is to be sent and take what has come; return the payloads among it."""
        for body in self.link.take_frames():
            self._line.sendall(encode_frame(body))
        try:
            chunk = self._line.recv(4096)
        except TimeoutError:
            return []
        bodies = [body for body in self._decoder.feed(chunk) if isinstance(body, bytes)]
        events = [event for body in bodies for event in self.link.receive(body, now_ns=time.monotonic_ns())]
        return [event for event in events if isinstance(event, PayloadReceived)]


def test_the_tap_passes_all_on_and_times_every_acknowledgement() -> None:
    n_payloads = 300  # more than there are sequence numbers
    with socket.create_server(("127.0.0.1", 0)) as server, LinkTap(host="127.0.0.1", port=server.getsockname()[1]) as tap:
        begun = time.monotonic()
        with socket.create_connection(("127.0.0.1", tap.port)) as near, server.accept()[0] as far:
            gateway, dongle = End(Role.INITIATOR, near), End(Role.RESPONDER, far)
            gateway.link.open(session=7, now_ns=time.monotonic_ns())
            held: list[tuple[float, int]] = []
            least: list[float] = []
            n_sent, payloads = 0, list[bytes]()
            while len(tap.waits) < n_payloads:
                assert time.monotonic() < begun + 120
                if dongle.link.state is LinkState.OPEN and n_sent < n_payloads and dongle.link.n_free:
                    dongle.link.send(n_sent.to_bytes(2, "little"), now_ns=time.monotonic_ns())
                    n_sent += 1
                dongle.turn()
                for event in gateway.turn():
                    payloads.append(event.payload)
                    held.append((time.monotonic(), event.receipt))
                # As a slow disk does: several are safe at once.
                if len(held) >= 5 or (held and n_sent == n_payloads):
                    least += [time.monotonic() - at for at, _ in held]
                    gateway.link.confirm(held[-1][1])
                    held.clear()
        assert payloads == [n.to_bytes(2, "little") for n in range(n_payloads)]
        waits = tap.waits_between(begun, time.monotonic())
        assert len(waits) == n_payloads
        assert all(wait >= shortest for wait, shortest in zip(waits, least, strict=True))
        assert max(waits) < time.monotonic() - begun


def test_shares_are_of_sorted_values() -> None:
    assert share([3.0, 1.0, 2.0], 0.5) == 2.0
    assert share([3.0, 1.0, 2.0], 1.0) == 3.0
    assert np.isnan(share([], 0.5))
