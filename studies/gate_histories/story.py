"""A history told line by line, for whoever looks for the fault."""

from firmware_protocol.messages import Stimulate
from firmware_protocol.units import NS_PER_S
from studies.gate_histories.air import Frame
from studies.gate_histories.calls import Call
from studies.gate_histories.world import World


def tell(world: World) -> str:
    """Return all that happened, in the order of true time [s]: lives, commands and stages, frames, electrodes."""
    lines: list[tuple[int, str]] = []
    for life in world.lives:
        lines.append((life.begin_ns, f"gateway starts, life {life.number}"))
        if life.end_ns is not None:
            lines.append((life.end_ns, f"gateway ends, life {life.number}"))
    for call in world.calls:
        request = call.request
        asked = f"{request.action.value} {request.node} ttl {request.ttl_ms} hold {request.hold_ms} {_age(call)}"
        lines.append((call.given_ns, f"{request.command_id}: {asked}"))
        for at, stage in call.stages:
            refusal = "" if stage.refusal is None else f" [{stage.refusal.value}]"
            lines.append((at, f"{request.command_id}: -> {stage.stage.value}{refusal} {stage.reason}"))
    for frame in world.air.frames:
        said = _said(frame)
        lines.append((frame.sent_ns, f"{said} is given to {frame.radio}"))
        if frame.written_ns is not None:
            lines.append((frame.written_ns, f"{said} leaves for the dongle"))
        elif frame.is_withdrawn:
            lines.append((frame.sent_ns, f"{said} is withdrawn later"))
        lines += [(at, f"{said} comes to a biobot") for at in frame.landed_ns]
    for biobot in world.biobots.values():
        for one in biobot.log:
            action = "hold is over" if one.action is None else one.action.name.lower()
            train = "" if one.train is None else f", a train of {(one.end_ns - one.begin_ns) / NS_PER_S:.3f} s"
            lines.append((one.begin_ns, f"electrode {one.node}: {action} {one.command}{train}"))
    lines += [(at, f"backpack {node} restarts") for at, node in world.restarted]
    return "\n".join(f"{at / NS_PER_S:10.3f}  {line}" for at, line in sorted(lines, key=lambda line: line[0]))


def _said(frame: Frame) -> str:
    message: Stimulate = frame.message
    whose = "nobody's" if frame.call is None else f"{frame.call.request.command_id}'s"
    return f"{whose} frame {message.command} ({message.action.name.lower()} {frame.node or 'all'}, {message.duration_ms} ms)"


def _age(call: Call) -> str:
    return "not taken" if call.given is None else f"age {call.given.age_ns / NS_PER_S:.3f} s"
