"""What became of commands, whoever gave them: each stage counts once, the worst gateway counts, and memory is bounded."""

import asyncio

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.commands import CommandStage, Refusal, Stage, StimulationAction, StimulationRequest
from firmware_protocol.units import EVERYBODY, Nanoseconds, NodeId
from mapper.changes import Changes, Topic
from mapper.command_log import KEPT, Command, CommandLog, Outcome, has_ended

FINAL = {Stage.BIOBOT_CONFIRMED, Stage.REFUSED, Stage.FAILED, Stage.UNKNOWN}
WORST_FIRST = [Stage.UNKNOWN, Stage.FAILED, Stage.REFUSED, Stage.BIOBOT_CONFIRMED]


def log_of() -> tuple[CommandLog, Changes]:
    changes = Changes()
    return CommandLog(changes=changes, wall_ns=iter(range(10**6)).__next__), changes


def outcome_of(command: Command) -> Outcome | None:
    return command.outcome


def request_of(
    command_id: str = "one", *, node: int = EVERYBODY, action: StimulationAction = StimulationAction.STOP_ALL
) -> StimulationRequest:
    return StimulationRequest(command_id="one", node=NodeId(node), action=action, operator="anna", issued_wall_ns=Nanoseconds(0))


def stage_of(
    stage: Stage,
    *,
    gateway: str = "gateway1",
    command_id: str = "one",
    node: int = EVERYBODY,
    action: StimulationAction = StimulationAction.STOP_ALL,
    part_of: str = "",
    refusal: Refusal | None = None,
) -> CommandStage:
    return CommandStage(
        command_id=command_id,
        gateway=gateway,
        node=NodeId(node),
        action=action,
        stage=stage,
        wall_ns=Nanoseconds(0),
        operator="bert",
        part_of=part_of,
        refusal=refusal,
    )


told = st.lists(st.tuples(st.sampled_from(["gateway1", "gateway2", "gateway3"]), st.sampled_from(Stage)), max_size=20)


@given(told)
def test_of_several_gateways_the_one_that_is_worst_off_counts_and_what_is_told_twice_counts_once(told: list[tuple[str, Stage]]) -> None:
    log, changes = log_of()
    heard: list[CommandStage] = []
    log.listen(heard.append)
    command = log.add(request_of(), gateway=None, asked=["gateway1", "gateway2"])
    before = changes.versions[Topic.COMMANDS]
    ends: dict[str, Stage] = {}
    fresh: set[tuple[str, Stage]] = set()
    for gateway, stage in told:
        log.take(stage_of(stage, gateway=gateway))
        if gateway not in ends and (gateway, stage) not in fresh:
            fresh.add((gateway, stage))
            if stage in FINAL:
                ends[gateway] = stage
    assert {(stage.gateway, stage.stage) for stage in heard} == fresh
    assert len(heard) == len(command.stages) == len(fresh) == changes.versions[Topic.COMMANDS] - before
    concerned = {"gateway1", "gateway2"} | {gateway for gateway, _ in told}
    if ends.keys() < concerned:
        assert not has_ended(command)
    else:
        assert command.outcome == next(stage.value for stage in WORST_FIRST if stage in ends.values())
    assert sorted(command.unfinished) == sorted(concerned - ends.keys())


def test_what_a_gateway_says_later_counts_more_than_what_was_made_of_its_silence() -> None:
    log, _ = log_of()
    command = log.add(request_of(), gateway=None, asked=["gateway1"])
    command.settle(outcome=Outcome.UNDELIVERED, reason="not there", gateways=["gateway1"])
    assert (outcome_of(command), command.reason) == (Outcome.UNDELIVERED, "not there")
    log.take(stage_of(Stage.ACCEPTED))
    assert outcome_of(command) is None
    command.settle(outcome=Outcome.UNKNOWN, reason="broke off", gateways=["gateway1"])
    command.is_closed = True
    log.take(stage_of(Stage.RADIO_CONFIRMED))
    assert outcome_of(command) is Outcome.UNKNOWN
    log.take(stage_of(Stage.BIOBOT_CONFIRMED))
    assert outcome_of(command) is Outcome.BIOBOT_CONFIRMED
    command.settle(outcome=Outcome.UNKNOWN, reason="late", gateways=["gateway1"])
    log.take(stage_of(Stage.UNKNOWN))
    assert outcome_of(command) is Outcome.BIOBOT_CONFIRMED


def test_gateways_that_do_not_know_a_biobot_have_no_part_in_its_stop() -> None:
    log, _ = log_of()
    command = log.add(request_of(node=5, action=StimulationAction.STOP), gateway=None, asked=["gateway1", "gateway2"])
    log.take(stage_of(Stage.REFUSED, refusal=Refusal.UNKNOWN_BIOBOT, node=5, action=StimulationAction.STOP))
    assert outcome_of(command) is None
    log.take(stage_of(Stage.BIOBOT_CONFIRMED, gateway="gateway2", node=5, action=StimulationAction.STOP))
    assert (outcome_of(command), command.refusal) == (Outcome.BIOBOT_CONFIRMED, None)


def test_a_stop_of_one_biobot_is_done_when_any_gateway_has_its_word() -> None:
    log, _ = log_of()
    command = log.add(request_of(node=5, action=StimulationAction.STOP), gateway=None, asked=["gateway1", "gateway2"])
    log.take(stage_of(Stage.BIOBOT_CONFIRMED, gateway="gateway2", node=5, action=StimulationAction.STOP))
    assert outcome_of(command) is Outcome.BIOBOT_CONFIRMED
    assert not command.is_settled
    log.take(stage_of(Stage.UNKNOWN, gateway="gateway1", node=5, action=StimulationAction.STOP))
    assert outcome_of(command) is Outcome.BIOBOT_CONFIRMED
    assert command.is_settled


def test_who_waits_for_a_command_is_woken_by_what_is_told_of_that_one() -> None:
    async def story() -> None:
        log, _ = log_of()
        mine = log.add(request_of(), gateway=None, asked=["gateway1"])
        n_looks = 0

        def has_ended_at_last() -> bool:
            nonlocal n_looks
            n_looks += 1
            return has_ended(mine)

        waiting = asyncio.create_task(log.wait(has_ended_at_last, of=[mine]))
        for number in range(50):
            await asyncio.sleep(0)
            log.take(stage_of(Stage.ACCEPTED, command_id=f"part-{number}", node=number, action=StimulationAction.STOP, part_of="one"))
        log.take(stage_of(Stage.BIOBOT_CONFIRMED))
        assert await waiting
        assert n_looks == 3, "when it began to wait, and when it was told of"
        assert not await log.wait(lambda: False, of=[mine], timeout_s=0.0)
        assert not log._waiting

    asyncio.run(story())


def test_a_stage_of_another_command_under_the_same_id_changes_nothing() -> None:
    log, _ = log_of()
    command = log.add(request_of(node=5, action=StimulationAction.START), gateway="gateway1", asked=["gateway1"])
    log.take(stage_of(Stage.REFUSED, node=6, action=StimulationAction.START, refusal=Refusal.ID_REUSED))
    log.take(stage_of(Stage.REFUSED, node=5, action=StimulationAction.STOP))
    assert (command.stages, command.outcome) == ([], None)


def test_commands_given_elsewhere_are_remembered_by_their_stages_up_to_a_limit_and_do_not_crowd_out_ones_own() -> None:
    log, _ = log_of()
    mine = log.add(request_of(), gateway=None, asked=["gateway1"])
    for number in range(KEPT + 7):
        log.take(stage_of(Stage.ACCEPTED, command_id=f"cli-{number}", node=number, action=StimulationAction.START))
        log.take(stage_of(Stage.ACCEPTED, command_id=f"part-{number}", node=number, action=StimulationAction.STOP, part_of="one"))
    listed = log.recent(limit=10_000)
    assert len(listed) == KEPT + 1
    assert listed[-1] is mine
    assert (listed[0].command_id, listed[0].operator, listed[0].request, listed[0].gateway) == (f"cli-{KEPT + 6}", "bert", None, "gateway1")
    parts = log.recent(limit=10_000, part_of="one")
    assert [part.command_id for part in parts] == [f"part-{number}" for number in range(KEPT + 6, 6, -1)]
    assert log.recent(limit=5, part_of="another") == []
    assert log.find("cli-0") is None
