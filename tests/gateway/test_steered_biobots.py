"""Laws of commanders and the dead-man between real processes: who steers is killed, hangs or leaves; the gateway is killed or ends."""

import asyncio
import json
import os
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import msgspec
import zenoh

from firmware_protocol.contract.commands import CommandStage, Refusal, Stage, StimulationAction
from firmware_protocol.contract.keys import ANY, Stream, build_key
from firmware_protocol.contract.records import decode_record
from firmware_protocol.messages import Action
from firmware_protocol.units import EVERYBODY, NodeId
from gateway.bus_stop import stop_everywhere
from gateway.commands.stop import _why_unsure
from gateway.config import GatewayConfig, StimulationTable
from tests.gateway.fake_radio import FakeBackpack, a_dongle, on_tcp, until
from tests.gateway.harness import Listener, a_config, a_request, command, listening, running

_ROOT = Path(__file__).parents[2]
_TABLE = StimulationTable(reply_timeout_s=4.0, stop_retry_s=0.3)


@asynccontextmanager
async def program(*arguments: str) -> AsyncIterator[Process]:
    """Run the command line in a process of its own, which is killed where it still runs in the end."""
    environment = {**os.environ, "PYTHONPATH": str(_ROOT), "PYTHONUNBUFFERED": "1"}
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "gateway", *arguments, stdin=asyncio.subprocess.DEVNULL, stdout=PIPE, stderr=PIPE, env=environment
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


def steering(config: GatewayConfig, node: int, script: str) -> list[str]:
    return ["steer", str(node), "--site", config.site, "--connect", config.listen[0], "--script", script]


async def introduced(peer: Listener, *backpacks: FakeBackpack) -> None:
    await peer.hear()
    for backpack in backpacks:
        backpack.say_hello()
        backpack.say_status(since_ms=1)
    await until(lambda: {status.node for status in peer.node_statuses} >= {one.node for one in backpacks}, what="the biobots are known")


def actions(backpack: FakeBackpack) -> list[Action]:
    return [stimulus.action for stimulus in backpack.obeyed]


def test_whoever_is_steered_stops_when_the_steering_process_dies_hangs_or_leaves(tmp_path: Path) -> None:
    """Killed, its token goes; stopped by a signal, it falls silent though its token stays; hung up, it stops the biobot itself."""

    async def story() -> None:
        ends = {7: signal.SIGKILL, 8: signal.SIGSTOP, 9: signal.SIGHUP}
        dongle = a_dongle(*ends)
        walking = {node: dongle.backpacks[NodeId(node)] for node in ends}
        stages: list[CommandStage] = []

        def take_stage(sample: zenoh.Sample) -> None:
            stages.append(decode_record(sample.payload.to_bytes(), CommandStage))

        async with on_tcp(dongle) as port, AsyncExitStack() as stack:
            # Long enough for a busy machine: one whose beats came late would be stopped before its end is tried.
            table = msgspec.structs.replace(_TABLE, commander_silence_s=4.0)
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}", stimulation=table)
            peer = stack.enter_context(listening(config))
            subscriber = peer.session.declare_subscriber(build_key(site="test", stream=Stream.STAGES, gateway=ANY), take_stage)
            await stack.enter_async_context(running(config))
            await introduced(peer, *walking.values())
            steerers = {node: await stack.enter_async_context(program(*steering(config, node, "start 60"))) for node in ends}
            await until(lambda: all(actions(one) == [Action.START] for one in walking.values()), what="all walk")
            for node, by in ends.items():
                steerers[node].send_signal(by)
            await until(lambda: all(actions(one) == [Action.START, Action.STOP] for one in walking.values()), what="all stop")
            assert await steerers[9].wait() == 0, "it has stopped its biobot itself, and knows it"

            def stopped_by() -> dict[int, str]:
                stops = [one for one in stages if one.stage is Stage.BIOBOT_CONFIRMED and one.action is StimulationAction.STOP]
                return {int(one.node): one.command_id.partition("-")[0] for one in stops}

            await until(lambda: stopped_by() == {7: "dead", 8: "dead", 9: "steer"}, what="the stages are published")
            absent = msgspec.structs.replace(a_request(7, StimulationAction.START), commander="nobody", hold_ms=1_000)
            (refused,) = await command(peer, absent)
            assert refused.refusal is Refusal.NO_COMMANDER
            subscriber.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    asyncio.run(story())


def test_a_script_of_which_a_step_was_refused_goes_on_and_fails_in_the_end(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(7)
        async with on_tcp(dongle) as port:
            seldom = msgspec.structs.replace(_TABLE, min_gap_s=600.0, commander_silence_s=60.0)
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}", stimulation=seldom)
            with listening(config) as peer:
                async with running(config):
                    backpack = dongle.backpacks[NodeId(7)]
                    await introduced(peer, backpack)
                    async with program(*steering(config, 7, "left 0.1; right 0.1; stop")) as steerer:
                        assert await steerer.wait() == 1
                        assert steerer.stderr is not None
                        assert b"1 of 3 steps were not confirmed" in await steerer.stderr.read()
                    assert actions(backpack) == [Action.TURN_LEFT, Action.STOP]

    asyncio.run(story())


def test_a_long_step_renews_its_hold_without_a_train_and_no_more_when_somebody_else_has_stopped_the_biobot(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(7)
        async with on_tcp(dongle) as port:
            # On a busy machine the steering process may be silent for a while, which is not what is tried here.
            table = msgspec.structs.replace(_TABLE, commander_silence_s=60.0)
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}", stimulation=table)
            with listening(config) as peer:
                async with running(config):
                    backpack = dongle.backpacks[NodeId(7)]
                    await introduced(peer, backpack)
                    async with program(*steering(config, 7, "left 3600"), "--hold-s", "5") as steerer:
                        await until(lambda: len(backpack.obeyed) >= 3, what="the hold is renewed, twice")
                        assert (await command(peer, a_request(7, StimulationAction.STOP)))[-1].stage is Stage.BIOBOT_CONFIRMED
                        steerer.send_signal(signal.SIGINT)
                        await steerer.wait()
                    n_before = actions(backpack).index(Action.STOP)
                    first, *renewals = backpack.obeyed[:n_before]
                    assert (first.action, first.hold_ms) == (Action.TURN_LEFT, 5000)
                    assert {(one.action, one.hold_ms, one.duration_ms) for one in renewals} == {(Action.START, 5000, 0)}
                    assert set(actions(backpack)[n_before:]) == {Action.STOP}, "nothing moves it after that; it may stop it once more"

    asyncio.run(story())


def test_a_gateway_that_ends_stops_whom_it_moves_and_one_that_is_killed_does_so_when_it_runs_again(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(7, 8, 9)
        first, second, free = (dongle.backpacks[NodeId(node)] for node in (7, 8, 9))
        async with on_tcp(dongle) as port:
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}", stimulation=_TABLE)
            run = [
                *("run", "--site", config.site, "--name", config.name, "--port", config.ports[0]),
                *("--journal", config.journal, "--listen", config.listen[0]),
            ]

            async def start(node: int, *, hold_ms: int) -> None:
                request = msgspec.structs.replace(a_request(node, StimulationAction.START), hold_ms=hold_ms)
                assert (await command(peer, request))[-1].stage is Stage.BIOBOT_CONFIRMED

            with listening(config) as peer:
                async with running(config):
                    await introduced(peer, first, second, free)
                    await start(8, hold_ms=600_000)
                    await start(9, hold_ms=0)
                assert actions(second) == [Action.START, Action.STOP], "it was stopped before the ports were closed"
                peer.node_statuses.clear()
                async with program(*run) as gateway:
                    await introduced(peer, first)
                    await start(7, hold_ms=600_000)
                    gateway.kill()
                    await gateway.wait()
                async with running(config):
                    await until(lambda: actions(first) == [Action.START, Action.STOP], what="the one that was moved is stopped")
                assert actions(second) == [Action.START, Action.STOP]
                assert Action.START not in actions(first)[1:]
                assert actions(free) == [Action.START], "nobody steers this one"

    asyncio.run(story())


def test_stop_reaches_every_gateway_of_a_site_without_knowing_their_names(tmp_path: Path) -> None:
    async def story() -> None:
        dongles = [a_dongle(7), a_dongle(8)]
        async with on_tcp(dongles[0]) as first_port, on_tcp(dongles[1]) as second_port:
            first = a_config(tmp_path, f"tcp:127.0.0.1:{first_port}", stimulation=_TABLE)
            second = msgspec.structs.replace(
                first,
                name="base2",
                ports=(f"tcp:127.0.0.1:{second_port}",),
                journal=str(tmp_path / "second.sqlite"),
                listen=(),
                connect=first.listen,
            )
            way = ["--site", first.site, "--connect", first.listen[0]]
            with listening(first) as peer:
                async with running(first), running(second):
                    await introduced(peer, *(backpack for dongle in dongles for backpack in dongle.backpacks.values()))
                    async with program("stop", "7", "8", *way) as stop:
                        out, err = await stop.communicate()
                        assert stop.returncode == 0, err
                    stages = [msgspec.convert(json.loads(line), CommandStage) for line in out.splitlines()]
                    assert {(one.gateway, one.node) for one in stages if one.stage is Stage.BIOBOT_CONFIRMED} == {
                        ("base1", 7),
                        ("base2", 8),
                    }
                    async with program("stop", "--all", *way) as stop:
                        _, err = await stop.communicate()
                        assert stop.returncode == 0, err
                        assert b"asked: base1, base2;" in err
                    hung = build_key(site=first.site, stream=Stream.ALIVE, gateway="hung")
                    token = peer.session.liveliness().declare_token(hung)
                    asked: set[str] = set()
                    everybody = a_request(EVERYBODY, StimulationAction.STOP_ALL)
                    stopping = stop_everywhere(
                        [everybody], site=first.site, gateway=None, connect=first.listen, timeout_s=5.0, tls=first.tls, on_gateway=asked.add
                    )
                    ends = [stage for stage in await asyncio.to_thread(list, stopping) if stage.is_final and not stage.part_of]
                    assert {one.gateway for one in ends} == {"base1", "base2"}
                    assert asked == {"base1", "base2", "hung"}
                    assert "not confirmed by gateway hung: look" in str(_why_unsure(everybody, ends, asked))
                    token.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type
                    dongles[1].backpacks[NodeId(8)].answers = False
                    async with program("stop", "8", "9", *way) as stop:
                        _, err = await stop.communicate()
                        assert stop.returncode == 1
                        assert b"biobot 8 has not confirmed that it stopped: look at the animal" in err
                        assert b"biobot 9 is known to no gateway that answered (base1, base2)" in err
            assert all(set(actions(backpack)) == {Action.STOP} for dongle in dongles for backpack in dongle.backpacks.values())

    asyncio.run(story())
