"""What backpacks announce and are told, through the whole gateway: limits, paths, diagnostics, configuration."""

import asyncio
from pathlib import Path

from firmware_protocol.contract.commands import Stage, StimulationAction
from firmware_protocol.contract.records import BackpackConfiguration, EncounterRecord
from firmware_protocol.messages import Capability, ConfigurationResult, Diagnostic, Level, Limits
from firmware_protocol.units import Milliseconds, NodeId
from gateway.config import BackpackTable
from tests.gateway.fake_radio import a_dongle, on_tcp, until
from tests.gateway.harness import a_config, a_request, command, listening, running

_LIMITS = Limits(
    channels=0b1,
    waveforms=0b1,
    max_frequency_hz=150,
    max_pulse_width_us=10_000,
    max_amplitude_mv=1_500,
    max_duration_ms=1_000,
    min_gap_ms=0,
    max_on_ms_per_minute=60_000,
    battery_mv=2_900,
    battery_empty_mv=2_000,
    encounter_capacity=256,
)


def test_announced_limits_are_published_and_refuse_commands_also_after_a_restart_of_the_gateway(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(1)
        backpack = dongle.backpacks[NodeId(1)]
        async with on_tcp(dongle) as port:
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}")
            for is_first in (True, False):
                with listening(config) as peer:
                    async with running(config):
                        await peer.hear()
                        if is_first:
                            backpack.say_hello()
                            backpack.say(_LIMITS)
                        backpack.say_status()
                        await until(lambda peer=peer: any(one.limits for one in peer.node_statuses), what="the limits are published")  # type: ignore[misc]  # the peer of this turn
                        status = peer.node_statuses[-1]
                        assert status.limits is not None
                        assert status.limits.max_amplitude_mv == 1_500
                        assert status.encounter_capacity == 256
                        stages = await command(peer, a_request(1, StimulationAction.START))
                        assert stages[-1].stage is Stage.REFUSED
                        assert "stimulation.amplitude_mv = 2000 mV" in stages[-1].reason
                        assert "at most 1500 mV" in stages[-1].reason
                        stages = await command(peer, a_request(1, StimulationAction.STOP))
                        assert stages[-1].stage is Stage.BIOBOT_CONFIRMED, "a stop is never refused"

    asyncio.run(story())


def test_paths_travel_with_their_side_and_diagnostics_become_events(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(1, 2)
        one, two = dongle.backpacks[NodeId(1)], dongle.backpacks[NodeId(2)]
        async with on_tcp(dongle) as port:
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}")
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    one.say_encounter(NodeId(2), ago_ms=500_000, duration_ms=2_000, path_mm=1_234)
                    two.say_encounter(NodeId(1), ago_ms=500_000, duration_ms=2_000)
                    one.say(Diagnostic(level=Level.WARNING, code=7, argument=42, at_ms=Milliseconds(1), text="loose electrode"))
                    await until(lambda: any(record.is_reciprocal for record in peer.of(EncounterRecord)), what="both sides are merged")
                    await until(lambda: any(event.kind == "node.diagnostic" for event in peer.events), what="the diagnostic is told")
                record = max(peer.of(EncounterRecord), key=lambda record: record.revision)
                assert {side.node: side.path_mm for side in record.sides} == {1: 1_234, 2: None}
                told = next(event for event in peer.events if event.kind == "node.diagnostic")
                assert (told.level, told.facts) == (
                    "warning",
                    {"node": "1", "code": "7", "argument": "42", "text": "loose electrode"},
                )

    asyncio.run(story())


def test_backpacks_are_set_as_the_configuration_says_and_one_that_will_not_be_is_told_of(tmp_path: Path) -> None:
    async def story() -> None:
        dongle = a_dongle(1, 2, 3)
        for node in (1, 2):
            dongle.backpacks[NodeId(node)].capabilities |= Capability.CONFIGURE
        dongle.backpacks[NodeId(2)].configuration_result = ConfigurationResult.NOT_SUPPORTED
        async with on_tcp(dongle) as port:
            config = a_config(tmp_path, f"tcp:127.0.0.1:{port}", backpacks=BackpackTable(rssi_enter_dbm=-60, report_period_ms=2_000))
            with listening(config) as peer:
                async with running(config):
                    await peer.hear()
                    for backpack in dongle.backpacks.values():
                        backpack.say_hello()
                        backpack.say_status()
                    await until(lambda: any(one.configuration for one in peer.node_statuses if one.node == 1), what="biobot 1 is set")
                    await until(lambda: any(event.kind == "node.not_configured" for event in peer.events), what="biobot 2 is told of")
                assert [len(backpack.configured) for backpack in dongle.backpacks.values()] == [1, 1, 0]
                told = [event for event in peer.events if event.kind == "node.not_configured"]
                assert [event.facts["node"] for event in told] == ["2"]
                status = [one for one in peer.node_statuses if one.node == 1][-1]
                assert status.configuration == BackpackConfiguration(rssi_enter_dbm=-60, report_period_ms=2_000)
                assert status.capabilities == Capability.STIMULATION | Capability.CONFIGURE

    asyncio.run(story())
