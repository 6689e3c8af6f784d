"""What must hold at the electrodes, in the journal and of the answers, whatever happens: judged after a history, from what was logged.

Written from the table of limits and the wire format alone: nothing here calls or knows the gate's own account.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator
from itertools import pairwise

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.messages import OWN_CHANNEL, Action, Limits, Stimulate, Waveform, WireMode
from firmware_protocol.units import NS_PER_MS, NS_PER_S, NodeId
from gateway.config import StimulationTable
from studies.gate_histories.air import Frame
from studies.gate_histories.calls import STOPS, Call
from studies.gate_histories.electrode import Actuation
from studies.gate_histories.world import World

_MINUTE_NS = 60 * NS_PER_S
_TICK_NS = NS_PER_MS
"""A backpack's clock and the wire count milliseconds: what lies within one of them is at the same time."""

_UNWRITTEN_S = 1.0
"""So long a frame may wait in the gateway for its dongle, before it is taken back."""

_SOON_NS = 2 * NS_PER_S


def violations(world: World) -> list[str]:
    """Return what was broken, in words; empty where all laws were kept."""
    found = [f"the gate's loop: {fault}" for fault in world.faults]
    found += _frames(world)
    found += _prompt(world)
    for biobot in world.biobots.values():
        found += _trains(world, biobot.log)
        found += _orders(world, biobot.node, biobot.log)
    for call in world.calls:
        found += _answers(world, call)
        found += _of_all(world, call)
    found += _record(world)
    return found


def _trains(world: World, log: list[Actuation]) -> Iterator[str]:
    """Pause, number and time of trains, as the electrode had them."""
    table, trains = world.site.table, [one for one in log if one.train is not None]
    for before, train in pairwise(trains):
        limits = _known_limits(world, train)
        gap_ns = int(max(table.min_gap_s, 0 if limits is None else limits.min_gap_ms / 1000) * NS_PER_S)
        if train.begin_ns - before.end_ns < gap_ns:
            yield f"pause: {_said(train)} began {(train.begin_ns - before.end_ns) / NS_PER_S:.3f} s after the end of {_said(before)}"
    for at, train in enumerate(trains):
        # The worst window that a train makes is the one that ends with it.
        window_ns = int(table.window_s * NS_PER_S)
        n_trains = sum(one.end_ns > train.begin_ns - window_ns for one in trains[: at + 1])
        if n_trains > table.max_trains:
            yield f"number: {_said(train)} was number {n_trains} in {table.window_s:g} s"
        if (on_ns := _on_ns(trains[: at + 1], until_ns=train.end_ns, window_ns=window_ns)) > table.max_on_s * NS_PER_S:
            yield f"time: with {_said(train)} there were {on_ns / NS_PER_S:.3f} s of stimulation in {table.window_s:g} s"
        limits = _known_limits(world, train)
        if (
            limits is not None
            and _on_ns(trains[: at + 1], until_ns=train.end_ns, window_ns=_MINUTE_NS) > limits.max_on_ms_per_minute * NS_PER_MS
        ):
            yield f"the backpack's time: {_said(train)} was beyond {limits.max_on_ms_per_minute} ms in a minute"
        yield from (f"pulse: {_said(train)} {why}" for why in _unfit(table, limits, train.train))


def _unfit(table: StimulationTable, limits: Limits | None, train: Stimulate | None) -> Iterator[str]:
    assert train is not None
    most = [(table.max_frequency_hz, table.max_amplitude_mv, table.max_pulse_width_us, table.max_duration_ms)]
    if limits is not None:
        most.append((limits.max_frequency_hz, limits.max_amplitude_mv, limits.max_pulse_width_us, limits.max_duration_ms))
        if train.channel == OWN_CHANNEL and not limits.channels:
            yield "left the channel to a backpack without any"
        if train.channel != OWN_CHANNEL and not limits.channels >> train.channel & 1:
            yield f"was for channel {train.channel}, which is not there"
        if not limits.waveforms >> train.waveform & 1:
            yield f"had waveform {train.waveform.name}, which the backpack does not announce"
    has = (train.frequency_hz, train.amplitude_mv, train.pulse_width_us, train.duration_ms)
    if train.frequency_hz < table.min_frequency_hz or any(
        value > limit for limit_s in most for value, limit in zip(has, limit_s, strict=True)
    ):
        yield f"has (Hz, mV, us, ms) {has}, beyond {most}, or less than {table.min_frequency_hz} Hz"
    if not train.amplitude_mv and train.action in {Action.TURN_LEFT, Action.TURN_RIGHT}:
        yield "was a turn without amplitude"
    if train.waveform is Waveform.MONOPHASIC and not table.allows_unbalanced:
        yield "was not balanced in charge"


def _orders(world: World, node: NodeId, log: list[Actuation]) -> Iterator[str]:
    """Who may move an insect, how often and until when."""
    frames = {frame.message.command: frame for frame in world.air.frames}
    executed: Counter[tuple[str, StimulationAction]] = Counter()
    moves: list[tuple[int, Call]] = []
    flight_ns = int(world.site.table.flight_s * NS_PER_S)
    for one in log:
        if one.command is None:
            continue
        frame = frames.get(one.command)
        call = None if frame is None else frame.call
        if call is None:
            if frame is None or one.action is not Action.STOP or one.train is not None:
                yield f"nobody's: {_said(one)}"
            continue
        request = call.request
        if one.train is not None or one.action is not Action.STOP:
            executed[request.command_id, request.action] += 1
        if one.action is Action.STOP:
            if request.action not in STOPS:
                yield f"made a stop: {_said(one)} of {_named(call)}"
            continue
        moves.append((one.begin_ns, call))
        yield from _moves(one, call, flight_ns=flight_ns)
        if (stop := _newer_stop(world, call)) is not None:
            yield f"issued before a stop: {_said(one)} of {_named(call)}, and {_named(stop)} had come"
    for (name, action), n in executed.items():
        # A stop that is asked for anew may be obeyed anew.
        n_asked = sum((call.request.command_id, call.request.action) == (name, action) for call in world.calls)
        if n > (n_asked if action in STOPS else 1):
            yield f"twice: {action.value} {name} was executed {n} times on biobot {node}"
    yield from _after_stops(world, node, log, moves)


def _moves(one: Actuation, call: Call, *, flight_ns: int) -> Iterator[str]:
    """A command moves as it was asked, in its time, and with its commander."""
    request = call.request
    if one.action is None or one.action.name.lower() != request.action.value:
        yield f"another action: {_said(one)} of {_named(call)}"
    assert call.given is not None
    left_ns = request.ttl_ms * NS_PER_MS - max(0, call.given.age_ns)
    if left_ns <= 0:
        yield f"stale: {_named(call)} was {call.given.age_ns / NS_PER_S:.3f} s old when it was given, and moved the insect"
    if (late_ns := one.begin_ns - (call.given_ns + left_ns + flight_ns)) > _TICK_NS:
        yield f"late: {_said(one)} of {_named(call)} came {late_ns / NS_PER_S:.3f} s after its time to live and the flight"
    if not call.given.is_commander_there:
        yield f"no commander: {_said(one)} of {_named(call)}"
    if request.commander and not request.hold_ms:
        yield f"no hold: {_said(one)} of {_named(call)}"


def _newer_stop(world: World, call: Call) -> Call | None:
    """Return a stop that had come to the same process within a minute before a call, and was issued after it."""
    for other in world.calls[: call.number]:
        if other.life is not call.life or other.given is None or call.given_ns - other.given_ns > _MINUTE_NS or not other.is_new:
            continue
        action, request = other.request.action, other.request
        is_of_one = action is StimulationAction.STOP and request.node == call.request.node and other.given.is_known
        # Of a clock that is ahead it is as if issued when it came.
        if (is_of_one or action is StimulationAction.STOP_ALL) and request.issued_wall_ns + min(
            0, other.given.age_ns
        ) > call.request.issued_wall_ns:
            return other
    return None


def _after_stops(world: World, node: NodeId, log: list[Actuation], moves: list[tuple[int, Call]]) -> Iterator[str]:
    """A confirmed stop did stop the insect, and no earlier command moves it after that."""
    for call in world.calls:
        if call.request.action is not StimulationAction.STOP or call.request.node != node or not call.is_new:
            continue  # of a message that came again it is told what became of it the first time
        confirmed_ns = next((at for at, stage in call.stages if stage.stage is Stage.BIOBOT_CONFIRMED), None)
        if confirmed_ns is None:
            continue
        wires = {frame.message.command for frame in world.air.frames if frame.call is not None and _is_of(frame.call, call)}
        if not any(one.mode is WireMode.S and one.command in wires and one.begin_ns <= confirmed_ns for one in log):
            yield f"not stopped: {_named(call)} was confirmed, and did nothing"
            continue
        stopped_ns = min(one.begin_ns for one in log if one.mode is WireMode.S and one.command in wires)
        for at, moving in moves:
            if at > stopped_ns and moving.number < call.number and not _is_stopped_again(world, node, at, stop=call):
                yield f"moved after a stop: {_named(moving)}, {(at - stopped_ns) / NS_PER_S:.3f} s after {_named(call)} had stopped it"


def _is_stopped_again(world: World, node: NodeId, moved_ns: int, *, stop: Call) -> bool:
    """Whether an insect that a frame moved which was on its way when a stop came is stopped again, or meant to move meanwhile.

    It is as soon as no frame of before the stop can come any more, which the gate cannot know better than by ``flight_s``, and by what it
    allows a frame to wait for its dongle; or when it hears of it.
    """
    by_ns = stop.given_ns + int((world.site.table.flight_s + _UNWRITTEN_S) * NS_PER_S) + _SOON_NS
    if any(life.end_ns is not None and stop.given_ns <= life.end_ns <= by_ns for life in world.lives):
        return True  # the gateway was killed before: who moves after its start is for those who know whom it had under control
    return any(
        frame.node == node and frame.message.action is Action.STOP and moved_ns <= frame.sent_ns <= by_ns for frame in world.air.frames
    ) or any(
        call.number > stop.number and call.request.node == node and call.request.action not in STOPS and call.given_ns <= by_ns
        for call in world.calls
    )


def _is_of(call: Call, other: Call) -> bool:
    return call.request.command_id == other.request.command_id


def _frames(world: World) -> Iterator[str]:
    """What may leave for the dongles."""
    of_wire: dict[int, set[str]] = defaultdict(set)
    trains: Counter[tuple[int, NodeId | None]] = Counter()
    for frame in world.air.frames:
        call, message = frame.call, frame.message
        if call is None:
            of_wire[message.command].add("the gate's own")
            if message.action is not Action.STOP or message.duration_ms:
                yield f"nobody's frame: {message}"
            continue
        of_wire[message.command].add(call.request.command_id)
        trains[message.command, frame.node] += message.duration_ms > 0
        if frame.node is None and (message.action is not Action.STOP or message.duration_ms):
            yield f"a broadcast that is not a mere stop: {_named(call)}"
        if message.action is Action.STOP:
            continue
        yield from _along_walls(world, frame, call)
        if frame.written_ns is not None:
            overtaker = _stop_between(world, call, frame)
            if overtaker is not None:
                late_s = (frame.written_ns - overtaker.given_ns) / NS_PER_S
                yield f"sent after a stop: a frame of {_named(call)} left {late_s:.3f} s after {_named(overtaker)} was given"
    for wire, names in of_wire.items():
        if len(names) > 1:
            yield f"number given twice: {wire}, for {sorted(names)}"
    for (wire, node), n in trains.items():
        if n > 1:
            yield f"frames with a train: {n} of number {wire}, to biobot {node}"


def _along_walls(world: World, frame: Frame, call: Call) -> Iterator[str]:
    """Only who has said since the backpack's start that it can is sent along walls, and has no train but one that is asked for."""
    if frame.message.action is not Action.FOLLOW_WALLS:
        return
    pulse = call.request.pulse
    if frame.message.duration_ms and (pulse is None or pulse.duration_ms is None):
        yield f"a train that nobody asked for: {_named(call)}"
    heard = [(at, boot) for at, node, boot in world.boots if node == frame.node and at <= frame.sent_ns]
    newest_ns = max((at for at, _ in heard if at < frame.sent_ns), default=0)
    boots = {boot for at, boot in heard if at >= newest_ns}  # what is heard in the instant of sending comes before or after it
    if not any(
        one.can_follow_walls and one.boot in boots and one.heard_ns <= frame.sent_ns and (one.life is frame.life or one.on_disk.done())
        for one in world.announced
        if one.node == frame.node
    ):
        yield f"along walls: {_named(call)} was sent to a backpack that has not said since its start that it can"


def _prompt(world: World) -> Iterator[str]:
    """A stop is given to its radio before anything else happens."""
    first: dict[int, int] = {}
    for frame in world.air.frames:
        if frame.call is not None:
            first.setdefault(frame.call.number, frame.sent_ns)
    for call in world.calls:
        can_send = call.given is not None and call.given.can_send
        if call.request.action is StimulationAction.STOP and call.is_new and can_send and first.get(call.number) != call.given_ns:
            yield f"a stop that waited: {_named(call)} was sent at {first.get(call.number)}"


def _stop_between(world: World, call: Call, frame: Frame) -> Call | None:
    """Return a stop of a frame's biobot that was given after its command, and before it left for the dongle."""
    assert frame.written_ns is not None
    for other in world.calls[call.number + 1 :]:
        if other.given_ns >= frame.written_ns or other.life is not call.life:
            break
        if not other.is_new:
            continue
        action = other.request.action
        if action is StimulationAction.STOP_ALL or (action is StimulationAction.STOP and other.request.node == call.request.node):
            return other
    return None


def _answers(world: World, call: Call) -> Iterator[str]:
    """One final stage to each command, in time, and of a refused one nothing else."""
    stages = [stage for _, stage in call.stages]
    finals = [stage for stage in stages if stage.is_final]
    if len(finals) > 1 or (finals and not stages[-1].is_final):
        yield f"final stages: {_named(call)} had {[stage.stage.value for stage in stages]}"
    if not finals and not call.life.is_over:
        yield f"no final stage: {_named(call)} had {[stage.stage.value for stage in stages]}"
    end_ns = world.time.now_ns if call.life.end_ns is None else call.life.end_ns
    if not stages and end_ns > call.given_ns + 2 * NS_PER_S:
        yield f"no answer: {_named(call)}"
    for at, (told_ns, stage) in enumerate(call.stages):
        if stage.is_final:
            continue
        if stage.deadline_wall_ns is None:
            yield f"no deadline: {_named(call)}, stage {stage.stage.value}"
            continue
        by_ns = told_ns + stage.deadline_wall_ns - stage.wall_ns + _TICK_NS
        next_ns = call.stages[at + 1][0] if at + 1 < len(call.stages) else end_ns
        if next_ns > by_ns:
            yield f"deadline: {_named(call)} was {stage.stage.value}, and the next stage came {(next_ns - by_ns) / NS_PER_S:.3f} s too late"
    final = finals[0] if finals else None
    if final is None or final.stage is not Stage.REFUSED:
        return
    if call.given is not None and call.given.is_known and call.request.action in STOPS:
        yield f"a refused stop: {_named(call)}: {final.reason}"
    if final.refusal is None:
        yield f"no reason for programs: {_named(call)}: {final.reason}"
    if any(frame.call is call and frame.written_ns is not None for frame in world.air.frames):
        yield f"refused and sent: {_named(call)}: {final.reason}"


def _of_all(world: World, call: Call) -> Iterator[str]:
    """That all have confirmed a stop is not said where the gateway knew somebody and nobody was stopped."""
    confirmed_ns = next((at for at, stage in call.stages if stage.stage is Stage.BIOBOT_CONFIRMED), None)
    is_of_all = call.request.action is StimulationAction.STOP_ALL and call.is_new
    if not is_of_all or confirmed_ns is None or call.given is None or not call.given.n_known:
        return
    wires = {frame.message.command for frame in world.air.frames if frame.call is not None and _is_of(frame.call, call)}
    logs = (one for biobot in world.biobots.values() for one in biobot.log)
    if not any(one.mode is WireMode.S and one.command in wires and one.begin_ns <= confirmed_ns for one in logs):
        yield f"nobody stopped: {_named(call)} was confirmed, and {call.given.n_known} biobots were known"


def _record(world: World) -> Iterator[str]:
    """Each train is in the journal: before it was sent, but for a stop's."""
    committed = sorted((at, entry.wire_command) for at, entry in world.disk.committed if entry.train_ms and entry.wire_command is not None)
    appended = {entry.wire_command for _, entry in world.appended if entry.train_ms}
    first = {wire: at for at, wire in reversed(committed)}
    for frame in world.air.frames:
        call, message = frame.call, frame.message
        if call is None or not message.duration_ms or not frame.landed_ns:
            continue
        at = first.get(message.command)
        if message.action is not Action.STOP:
            if at is None or at > frame.sent_ns:
                yield f"not on record: {_named(call)} was sent before its train was on disk"
        elif message.command not in appended:
            yield f"not on record: {_named(call)} had a train that the journal was not given"
        elif at is None and not frame.life.is_over:
            yield f"not on record: the train of {_named(call)} never came to the disk"


def _known_limits(world: World, train: Actuation) -> Limits | None:
    """Return what the gateway was last told of a backpack's limits before the frame of a train was sent, None: nothing."""
    frame = next((frame for frame in world.air.frames if frame.message.command == train.command), None)
    if frame is None:
        return None
    told = [
        one
        for one in world.announced
        if one.node == train.node and one.heard_ns < frame.sent_ns and (one.life is frame.life or one.on_disk.done())
    ]
    return told[-1].limits if told else None


def _on_ns(trains: list[Actuation], *, until_ns: int, window_ns: int) -> int:
    return sum(max(0, min(one.end_ns, until_ns) - max(one.begin_ns, until_ns - window_ns)) for one in trains)


def _said(one: Actuation) -> str:
    action = "nobody" if one.action is None else one.action.name.lower()
    return f"{action} {one.command} of biobot {one.node} at {one.begin_ns / NS_PER_S:.3f} s"


def _named(call: Call) -> str:
    request = call.request
    return f"{request.command_id} ({request.action.value} {request.node}, given at {call.given_ns / NS_PER_S:.3f} s)"
