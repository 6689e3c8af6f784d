"""A history of the gate: the real gate in virtual time, between commanders, a disk, radios, backpacks and a machine that fail.

All that happens is an event, a method of ``World``; nothing is drawn here, so the same events are the same history.
"""

import asyncio
from collections import Counter
from dataclasses import dataclass

import msgspec

from firmware_protocol.contract.commands import CommandStage, PulseRequest, StimulationAction, StimulationRequest
from firmware_protocol.messages import Capability, Hello, Limits
from firmware_protocol.units import EVERYBODY, NS_PER_MS, NS_PER_S, BootId, Nanoseconds, NodeId, RssiDbm, ShortAddress
from gateway.config import StimulationTable
from gateway.health import Health
from gateway.journal_file import AuditEntry, JournalWrite
from gateway.nodes import Node, NodeBook, NodeMemory
from gateway.stimulation import StimulationGate
from studies.gate_histories.air import GOOD, Air, FrameFate, Radio, Sender
from studies.gate_histories.calls import CURRENT_CALL, Call, Given, Life
from studies.gate_histories.disk import Disk, LiveJournal, Rows
from studies.gate_histories.electrode import Answer, Biobot
from studies.gate_histories.virtual_time import TrueTime, VirtualLoop

_GATEWAY = "g"
_FIRST_WALL_NS = 1_700_000_000 * NS_PER_S
_ODD = 0x9E3779B1
_STRENGTH = RssiDbm(-50)
_HEARD_AFTER_NS = 20 * NS_PER_MS
"""A biobot answers the gateway's first question so long after its start, where a radio is up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """What a history begins with: the limits, how long radios tell nothing, who is there, and which radio hears whom."""

    table: StimulationTable
    radio_timeout_s: float
    limits: tuple[Limits, ...]
    """What each biobot announces; biobots are numbered from 1."""
    radios: tuple[frozenset[int], ...]
    """Which numbers each radio hears."""
    wall_followers: frozenset[int]
    """Numbers whose backpacks can follow walls."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What is asked of the gate; ``late_ms`` is how long ago it was issued by the gateway's wall clock, ``commander`` empty: nobody's."""

    action: StimulationAction
    node: int
    ttl_ms: int = 5_000
    hold_ms: int = 0
    late_ms: int = 0
    commander: str = ""
    pulse: PulseRequest | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Announcement:
    """The gateway heard what a biobot's limits are, and what it can; it knows it after its process too once ``on_disk`` is done."""

    heard_ns: int
    node: NodeId
    boot: BootId
    limits: Limits
    can_follow_walls: bool
    life: Life
    on_disk: "asyncio.Future[None]"


@dataclass(slots=True, eq=False, kw_only=True)
class _Running:
    """A process of the gateway."""

    life: Life
    loop: VirtualLoop
    journal: LiveJournal
    nodes: NodeBook
    sender: Sender
    gate: StimulationGate


class World:
    """See the module. ``close`` must be called at the end."""

    def __init__(self, site: Site, *, rows: Rows) -> None:
        self.site = site
        self.time = TrueTime()
        self.wall_offset_ns = _FIRST_WALL_NS
        self.calls: list[Call] = []
        self.lives: list[Life] = []
        self.appended: list[tuple[int, AuditEntry]] = []
        """Rows that the gate gave to the journals of all its lives, and when."""
        self.announced: list[Announcement] = []
        self.boots: list[tuple[int, NodeId, BootId]] = []
        """Which start of a backpack the gateway heard, and when."""
        self.restarted: list[tuple[int, NodeId]] = []
        self.faults: list[str] = []
        """What went wrong in the gate's own loop."""
        self.counts: Counter[str] = Counter()
        self.disk = Disk(rows=rows)
        self.commanders: set[str] = set()
        nodes = [NodeId(number + 1) for number in range(len(site.limits))]
        radios = {f"r{n}": Radio(name=f"r{n}", hears=frozenset(NodeId(one) for one in hears)) for n, hears in enumerate(site.radios)}
        self.air = Air(true_time=self.time, radios=radios, flight_s=site.table.flight_s, radio_timeout_s=site.radio_timeout_s)
        self.air.biobots = self.biobots = {
            node: Biobot(
                node=node,
                limits=limits,
                can_follow_walls=node in site.wall_followers,
                true_time=self.time,
                answer=self.air.answer,
            )
            for node, limits in zip(nodes, site.limits, strict=True)
        }
        self.air.hear = self._hear
        self._n_ids = 0
        self._n_drawn = 0
        self._machine_boot_ns = -20 * NS_PER_S
        self._n_machine_boots = 1
        self._running = self._begin_life()

    @property
    def now_wall_ns(self) -> int:
        """What the machine's wall clock shows."""
        return self.time.now_ns + self.wall_offset_ns

    # What happens

    def order(self, order: Order) -> Call:
        """Give the gate a command under a new id."""
        self._n_ids += 1
        self.counts["commands"] += 1
        is_all = order.action is StimulationAction.STOP_ALL
        return self._give(
            StimulationRequest(
                command_id=f"c{self._n_ids}",
                node=EVERYBODY if is_all else NodeId(order.node),
                action=order.action,
                operator="op",
                issued_wall_ns=Nanoseconds(self.now_wall_ns - order.late_ms * NS_PER_MS),
                ttl_ms=order.ttl_ms,
                hold_ms=order.hold_ms,
                commander=order.commander,
                pulse=order.pulse,
            )
        )

    def repeat(self, back: int, *, action: StimulationAction | None = None) -> Call | None:
        """Give the gate an earlier command again, or (with ``action``) another one under its id."""
        if not self.calls:
            return None
        self.counts["repetitions"] += 1
        request = self.calls[-1 - back % len(self.calls)].request
        is_all = StimulationAction.STOP_ALL in {request.action, action}
        return self._give(request if action is None or is_all else msgspec.structs.replace(request, action=action))

    def wait(self, ms: int) -> None:
        """Let time pass."""
        self._running.loop.run_until(self.time.now_ns + ms * NS_PER_MS)

    def jump_wall_clock(self, ms: int) -> None:
        """Set the machine's wall clock, forward or back."""
        self.counts["clock jumps"] += 1
        self.wall_offset_ns += ms * NS_PER_MS

    def restart_gateway(self, *, down_ms: int, is_reboot: bool = False) -> None:
        """End the gateway's process by SIGKILL, and start it again after a while; with a reboot its monotonic clock begins anew."""
        self.counts["reboots" if is_reboot else "restarts"] += 1
        self._end_life()
        end_ns = self.time.now_ns + down_ms * NS_PER_MS
        self.time.at(end_ns, lambda: None)
        while self.time.now_ns < end_ns:
            self.time.pass_until(end_ns)
        if is_reboot:
            self._machine_boot_ns = self.time.now_ns - min(down_ms, 20_000) * NS_PER_MS
            self._n_machine_boots += 1
        self._running = self._begin_life()

    def restart_backpack(self, node: int) -> None:
        """Let a backpack forget everything."""
        self.counts["backpack restarts"] += 1
        self.restarted.append((self.time.now_ns, NodeId(node)))
        self.biobots[NodeId(node)].restart()

    def set_fates(self, radio: int, fates: tuple[FrameFate, ...]) -> None:
        """Say what becomes of a radio's next frames."""
        one = self._radio(radio)
        one.fates, one.n_frames = fates, 0

    def set_radio(self, radio: int, *, is_up: bool) -> None:
        """Let a radio's port be lost, or be there again."""
        one = self._radio(radio)
        if one.is_up and not is_up:
            self.counts["lost ports"] += 1
            self.air.lose_port(one.name)
        one.is_up = is_up

    def set_disk(self, *, is_full: bool, commit_ms: int = 2) -> None:
        """Let the disk be full, or take writes after a while."""
        self.counts["full disks"] += is_full
        self.disk.is_full, self.disk.commit_ms = is_full, commit_ms

    def set_commander(self, name: str, *, is_there: bool) -> None:
        """Let a commander come or go."""
        (self.commanders.add if is_there else self.commanders.discard)(name)

    def hear(self, node: int, *, announces: bool = False) -> None:
        """Let a biobot be heard, by the first radio that is up, and announce its limits."""
        radio = self.air.way_from(NodeId(node))
        if radio is None:
            return
        book = self._take(NodeId(node), radio)
        known = book.find(NodeId(node))
        if announces and known is not None:
            biobot = self.biobots[NodeId(node)]
            walls = Capability.FOLLOW_WALLS if biobot.can_follow_walls else Capability(0)
            book.introduce(known, Hello(eui64=node, firmware=1, beacon_period_ms=0, capabilities=Capability.STIMULATION | walls))
            book.take_limits(known, biobot.limits)
            self.announced.append(
                Announcement(
                    heard_ns=self.time.now_ns,
                    node=known.node,
                    boot=biobot.boot,
                    limits=biobot.limits,
                    can_follow_walls=biobot.can_follow_walls,
                    life=self._running.life,
                    on_disk=self._remember(known),
                )
            )

    def recover(self) -> None:
        """Let disk and radios work, and all biobots be heard and announce their limits."""
        self.set_disk(is_full=False)
        for radio in self.air.radios.values():
            radio.is_up, radio.fates = True, (GOOD,)
        for node in self.biobots:
            self.hear(node, announces=True)

    def close(self) -> None:
        """Let all that fails work again, until each command has had its last answer; then end."""
        self.set_disk(is_full=False)
        for radio in self.air.radios.values():
            radio.is_up = True
        self.wait(120_000)
        self._end_life()

    # The gateway around the gate

    def _begin_life(self) -> _Running:
        boot_ns = self._machine_boot_ns
        life = Life(number=len(self.lives), boot_ns=boot_ns, begin_ns=self.time.now_ns)
        self.lives.append(life)
        loop = VirtualLoop(self.time, boot_ns=boot_ns)
        loop.set_exception_handler(self._note_fault)
        nodes = NodeBook(gateway=_GATEWAY)
        memories = [msgspec.msgpack.decode(body, type=NodeMemory) for body in self.disk.nodes.values()]
        nodes.restore(memories, heard_ns={}, now_ns=self.time.now_ns - boot_ns)
        journal = LiveJournal(loop=loop, disk=self.disk, true_time=self.time, appended=self.appended)

        def now_ns() -> int:
            return self.time.now_ns - boot_ns

        opened = self.disk.rows.open(wall_clock=lambda: self.now_wall_ns, clock=now_ns, machine_boot=f"boot {self._n_machine_boots}")

        sender = Sender(air=self.air, life=life, nodes=nodes, now_ns=now_ns)

        async def make() -> StimulationGate:
            return StimulationGate(
                gateway=_GATEWAY,
                config=self.site.table,
                sender=sender,
                nodes=nodes,
                journal=journal,
                reader=opened.reader,
                health=Health(),
                wall_clock=lambda: self.now_wall_ns,
                instant_of=opened.identity.instant_of,
                radio_timeout_s=self.site.radio_timeout_s,
                now_ns=now_ns,
                new_number=self._draw_number,
                is_commander_there=self.commanders.__contains__,
            )

        running = _Running(life=life, loop=loop, journal=journal, nodes=nodes, sender=sender, gate=loop.run_until_complete(make()))
        for node in self.biobots:
            self.time.after(_HEARD_AFTER_NS, lambda node=node: None if life.is_over else self.hear(node))  # type: ignore[misc]
        return running

    def _draw_number(self) -> int:
        """Return a number of 31 bits that was not drawn before."""
        self._n_drawn += 1
        return self._n_drawn * _ODD % (1 << 31)

    def _end_life(self) -> None:
        running = self._running
        running.life.end_ns = self.time.now_ns
        running.journal.kill()
        tasks = asyncio.all_tasks(running.loop)
        for task in tasks:
            task.cancel()
        if tasks:
            running.loop.run_until_complete(asyncio.wait(tasks))
        running.loop.close()
        self.disk.rows.close()

    def _give(self, request: StimulationRequest) -> Call:
        running = self._running
        call = Call(
            number=len(self.calls),
            request=request,
            life=running.life,
            given_ns=self.time.now_ns,
            is_new=all(one.request != request for one in self.calls),
        )
        self.calls.append(call)

        def listen(stage: CommandStage) -> None:
            if not call.life.is_over:
                call.stages.append((self.time.now_ns, stage))

        async def handle() -> None:
            CURRENT_CALL.set(call)
            call.given = Given(
                age_ns=self.now_wall_ns - request.issued_wall_ns,
                is_known=running.nodes.find(request.node) is not None,
                can_send=running.sender.can_send(request.node),
                is_commander_there=not request.commander or request.commander in self.commanders,
                n_known=len(running.nodes),
            )
            await running.gate.handle(request, listen)

        task = running.loop.create_task(handle())
        task.add_done_callback(
            lambda done: None if done.cancelled() or done.exception() is None else self.faults.append(repr(done.exception()))
        )
        return call

    def _hear(self, answer: Answer, radio: str) -> bool:
        """Take an answer as the gateway does: the gate is told at once, and again when it is on disk."""
        running = self._running
        if running.life.is_over:
            return False
        self._take(answer.node, radio)
        running.gate.on_answer(answer.node, answer.reply)
        on_disk = running.journal.append(JournalWrite())
        on_disk.add_done_callback(lambda _: None if running.life.is_over else running.gate.on_reply(answer.node, answer.reply))
        return True

    def _take(self, node: NodeId, radio: str) -> NodeBook:
        """Have a radio hear a biobot now."""
        book, biobot = self._running.nodes, self.biobots[node]
        self.boots.append((self.time.now_ns, node, biobot.boot))
        known, has_changed = book.heard(
            node=node,
            boot=biobot.boot,
            radio=radio,
            address=ShortAddress(node),
            rssi_dbm=_STRENGTH,
            lqi=200,
            sent_ms=biobot.now_ms(),
            now_ns=self.time.now_ns - self._running.life.boot_ns,
            now_wall_ns=Nanoseconds(self.now_wall_ns),
        )
        if has_changed:
            self._remember(known)
        return book

    def _remember(self, node: Node) -> "asyncio.Future[None]":
        return self._running.journal.append(JournalWrite(node=(node.node, msgspec.msgpack.encode(node.memory()))))

    def _note_fault(self, _loop: asyncio.AbstractEventLoop, context: dict[str, object]) -> None:
        self.faults.append(f"{context.get('message')}: {context.get('exception')!r}")

    def _radio(self, number: int) -> Radio:
        return self.air.radios[f"r{number}"]
