"""A gateway without radios that tells of many biobots, all of whom have changed each time: ``python -m studies.page_speed.herd``."""

import argparse
import asyncio
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from firmware_protocol.contract.commands import CommandStage, Stage, StimulationRequest
from firmware_protocol.contract.records import Cause, GatewayStatus, Mode, NodeStatus
from firmware_protocol.units import BootId, Nanoseconds, NodeId, RssiDbm
from gateway.bus import Bus
from gateway.bus_commands import CommandAnswer
from gateway.config import GatewayConfig
from gateway.health import Health
from gateway.journal import Journal

NAME: Final = "herd"
_NS_PER_S: Final = 1_000_000_000
_HEARD_S: Final = 20.0
_BATTERY_MV: Final = (2_000, 4_000)
_RSSI_DBM: Final = (-97, -50)


def main(arguments: Sequence[str] | None = None) -> int:
    """Tell of biobots until killed, or told to end by a signal."""
    parser = argparse.ArgumentParser(prog="python -m studies.page_speed.herd", description=__doc__)
    parser.add_argument("--biobots", type=int, required=True)
    parser.add_argument("--period-s", type=float, default=0.5, help="between two statuses of each (default: %(default)s)")
    parser.add_argument("--journal", type=Path, required=True, metavar="FILE")
    parser.add_argument("--listen", required=True, metavar="EP", help="Zenoh endpoint")
    try:
        asyncio.run(_run(parser.parse_args(arguments)))
    except KeyboardInterrupt:
        return 0
    return 0


async def _run(options: argparse.Namespace) -> None:
    health = Health()
    journal = Journal.open(options.journal, health=health)
    bus = await asyncio.to_thread(Bus.open, GatewayConfig(name=NAME, journal=str(options.journal), listen=(options.listen,)), health=health)
    try:
        bus.start(on_command=_refuse, open_reader=journal.reader, journal=journal.journal_id)
        rng = np.random.default_rng(1)
        while True:
            _tell(bus, journal, rng, n_biobots=options.biobots)
            await asyncio.sleep(options.period_s)
    finally:
        await asyncio.to_thread(bus.close)
        await asyncio.to_thread(journal.close)


def _refuse(request: StimulationRequest, answer: CommandAnswer) -> None:
    answer.tell(
        CommandStage(
            command_id=request.command_id,
            gateway=NAME,
            node=request.node,
            action=request.action,
            stage=Stage.REFUSED,
            wall_ns=Nanoseconds(time.time_ns()),
            reason="this gateway has no radio",
        )
    )


def _tell(bus: Bus, journal: Journal, rng: np.random.Generator, *, n_biobots: int) -> None:
    """Tell of all of them: when each was heard, its battery and its signal are drawn anew."""
    now_ns = time.time_ns()
    heard_ns = now_ns - (rng.uniform(0, _HEARD_S, n_biobots) * _NS_PER_S).astype(np.int64)
    battery_mv, rssi_dbm = (rng.integers(low, high, n_biobots) for low, high in (_BATTERY_MV, _RSSI_DBM))
    bus.publish_gateway_status(
        GatewayStatus(
            gateway=NAME,
            journal=journal.journal_id,
            boot=journal.boot,
            head_offset=journal.head_offset,
            wall_ns=Nanoseconds(now_ns),
            radios={},
            counters={},
        )
    )
    for index in range(n_biobots):
        bus.publish_node_status(
            NodeStatus(
                gateway=NAME,
                radio="none",
                node=NodeId(index + 1),
                eui64=index + 1,
                boot=BootId(1),
                mode=Mode.CRW,
                cause=Cause.NATURAL,
                battery_mv=int(battery_mv[index]),
                rssi_dbm=RssiDbm(int(rssi_dbm[index])),
                lqi=200,
                last_heard_wall_ns=Nanoseconds(int(heard_ns[index])),
                buffered=0,
                dropped=0,
            )
        )


if __name__ == "__main__":
    raise SystemExit(main())
