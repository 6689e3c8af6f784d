"""From commands, stops, accounts and missions to the JSON objects that ``command_schemas`` describes."""

from collections.abc import Iterable
from typing import Final

import msgspec

from firmware_protocol.contract.commands import StimulationAccount
from firmware_protocol.contract.mission_orders import MissionAnswer, MissionOrder
from firmware_protocol.contract.records import MissionRecord, RecordHead
from firmware_protocol.units import EVERYBODY, NS_PER_MS, NodeId
from mapper.command_log import Answer, Command
from mapper.emergency_stop import Stop

_TOLD_OTHERWISE: Final = {*RecordHead.__struct_fields__, "t_start_ns"}


def view_command(command: Command) -> dict[str, object]:
    """Describe a command as it stands."""
    request = command.request
    return {
        "id": command.command_id,
        "biobot": _biobot(command.node),
        "gateway": command.gateway,
        "action": command.action,
        "operator": command.operator,
        "origin": "elsewhere" if request is None else "here",
        "part_of": command.part_of or None,
        "began_wall_ns": command.began_wall_ns,
        "issued_wall_ns": request and request.issued_wall_ns,
        "ttl_ms": request and request.ttl_ms,
        "hold_ms": request and request.hold_ms,
        "commander": (request and request.commander) or None,
        "pulse": request and request.pulse,
        "stages": [
            {
                "gateway": stage.gateway,
                "stage": stage.stage,
                "wall_ns": stage.wall_ns,
                "reason": stage.reason,
                "mode": stage.mode,
                "refusal": stage.refusal,
                "deadline_wall_ns": stage.deadline_wall_ns,
            }
            for stage in command.stages
        ],
        "answers": [_view_answer(gateway, answer) for gateway, answer in command.answers.items()],
        "outcome": command.outcome,
        "reason": command.reason,
        "refusal": command.refusal,
    }


def view_stop(stop: Stop) -> dict[str, object]:
    """Describe a stop as it stands."""
    return {
        "id": stop.stop_id,
        "operator": stop.operator,
        "biobots": stop.biobots,
        "has_ended": stop.has_ended,
        "answers": [
            {"biobot": _biobot(command.node), "command_id": command.command_id, **_view_answer(gateway, answer)}
            for command in stop.commands
            for gateway, answer in command.answers.items()
        ],
        "unanswered": stop.silent,
    }


def view_account(account: StimulationAccount) -> dict[str, object]:
    """Describe how a biobot was stimulated."""
    told = {name: getattr(account, name) for name in account.__struct_fields__ if name != "node"}
    return {
        "biobot": account.node,
        **told,
        "ready_wall_ns": account.wall_ns + account.ready_in_ms * NS_PER_MS,
        "controlled_by": account.controlled_by or None,
    }


def view_mission(records: Iterable[MissionRecord]) -> dict[str, object]:
    """Describe all phases, in the order in which they began, the newest of each gateway, and the newest of all."""
    phases = [_view_phase(record) for record in records]
    newest = {str(phase["gateway"]): phase for phase in phases}
    return {"phase": phases[-1] if phases else None, "gateways": [newest[name] for name in sorted(newest)], "phases": phases}


def view_order(order: MissionOrder, answers: Iterable[MissionAnswer]) -> dict[str, object]:
    """Describe an order and its answers."""
    return {
        "id": order.order_id,
        "action": order.action,
        "operator": order.operator,
        "answers": [{name: getattr(answer, name) for name in answer.__struct_fields__ if name != "order_id"} for answer in answers],
    }


def _view_phase(record: MissionRecord) -> dict[str, object]:
    told = {name: getattr(record, name) for name in record.__struct_fields__ if name not in _TOLD_OTHERWISE}
    told = {name: value for name, value in told.items() if value is not msgspec.UNSET}
    return {"gateway": record.gateway, "t_start_wall_ns": record.t_start_ns + record.wall_anchor_ns, **told}


def _view_answer(gateway: str, answer: Answer) -> dict[str, object]:
    return {
        "gateway": gateway,
        "stage": answer.stages[-1].stage if answer.stages else None,
        "outcome": answer.outcome,
        "reason": answer.reason,
        "refusal": answer.refusal,
    }


def _biobot(node: NodeId) -> NodeId | None:
    return None if node == EVERYBODY else node
