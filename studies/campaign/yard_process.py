"""A yard in real time behind its lines, as a process of its own: ``python -m studies.campaign.yard_process CONFIG.json``.

Orders come in on standard input, one JSON object a line; what becomes of them and how the yard is doing goes out on standard output.
"""

import asyncio
import json
import random
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from firmware_protocol.units import NS_PER_S, NodeId
from simulator.lines.carrier import Carrier, open_line
from simulator.lines.line import parse_line
from simulator.log import set_up_logging
from studies.campaign.ledger import Ledger
from studies.campaign.troubled_end import TroubledEnd
from studies.campaign.yard import Yard
from studies.campaign.yard_config import YardConfig

_SHORTEST_SLEEP_NS = 2_000_000
_STATE_PERIOD_NS = NS_PER_S // 4
_LOOK_S = 0.05
_LONGEST_LEAVE_S = 30.0


@dataclass(slots=True, kw_only=True)
class _Watch:
    """An order that is done when each of its lines, or its one biobot, has had something confirmed that was sent since."""

    order: int
    since_ns: int
    lines: set[int]
    node: NodeId | None = None


@dataclass(slots=True, kw_only=True)
class YardProcess:
    """Drives a yard by the clock and obeys orders."""

    config: YardConfig
    yard: Yard
    lines: tuple[TroubledEnd, ...]
    random: random.Random
    carriers: tuple[Carrier, ...] = ()
    _wake: asyncio.Event = field(default_factory=asyncio.Event)
    _watches: list[_Watch] = field(default_factory=list)
    _is_over: bool = False
    _state_at_ns: int = 0

    async def run(self) -> None:
        """Run until the order to quit, or until nobody gives orders any more."""
        self.carriers = tuple(
            Carrier(self.yard.dongles[at], line=line, feed=self._feeder(at), options=parse_line(self.config.lines[at]).gateway_options)
            for at, line in enumerate(self.lines)
        )
        _tell({"ready": [carrier.address for carrier in self.carriers]})
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(work) for one in self.carriers for work in (one.receive(), one.send())]
            tasks.append(group.create_task(self._take_orders(group)))
            while not self._is_over:
                self._turn()
                delay_ns = max(_SHORTEST_SLEEP_NS, min(self.yard.next_due_ns(), self._state_at_ns) - self._now_ns())
                alarm = asyncio.get_running_loop().call_later(delay_ns / NS_PER_S, self._wake.set)
                await self._wake.wait()
                alarm.cancel()
                self._wake.clear()
            for task in tasks:
                task.cancel()
        for line in self.lines:
            await line.aclose()

    def _turn(self) -> None:
        now_ns = self._now_ns()
        self.yard.step(now_ns)
        for carrier in self.carriers:
            carrier.pump()
        self._look_at_watches()
        if now_ns >= self._state_at_ns:
            self._state_at_ns = now_ns + _STATE_PERIOD_NS
            _tell(
                {
                    "meetings": self.yard.n_meetings,
                    "open": sum(one.is_open for one in self.carriers),
                    "left_out": self.yard.n_left_out,
                    "waiting": self.yard.n_waiting,
                    "dropped": self.yard.n_dropped,
                    "is_settled": self.yard.is_settled,
                    "behind_s": self._behind_s(now_ns),
                }
            )

    def _behind_s(self, now_ns: int) -> float:
        return round(max(0, now_ns - self.yard.next_due_ns()) / NS_PER_S, 2)

    def _look_at_watches(self) -> None:
        confirmed, self.yard.acknowledged = self.yard.acknowledged, []
        if not self._watches:
            return
        for watch in self._watches:
            for line, sent_ns, node in confirmed:
                if sent_ns >= watch.since_ns and watch.node in {None, node}:
                    watch.lines.discard(line)
        for watch in [one for one in self._watches if not one.lines]:
            self._watches.remove(watch)
            _tell({"recovered": watch.order})

    async def _take_orders(self, group: asyncio.TaskGroup) -> None:
        reader = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
        while line := await reader.readline():
            order = json.loads(line)
            if order["do"] == "quit":
                break
            if order["do"] == "begin":
                self.yard.begin(order["at_ns"] - self.config.t0_ns)
            elif order["do"] == "stop":
                self.yard.stop(self._now_ns())
            else:
                group.create_task(self._obey(order))
        self._is_over = True
        self._wake.set()

    async def _obey(self, order: dict[str, Any]) -> None:
        """Do one thing for as long as it is to last, and watch for the recovery from then on."""
        number, what, at, lasts_s = order["order"], order["do"], order.get("line", 0), order.get("lasts_s", 0.0)
        line = self.lines[at]
        lines, node = {at}, None
        match what:
            case "watch":
                lines = set(order["lines"])
            case "unplug" | "power_cut":
                await line.cable.unplug()
                await asyncio.sleep(lasts_s)
                if what == "power_cut":
                    self.yard.reset(at, now_ns=self._now_ns())
                await line.cable.plug_in()
            case "stall":
                await line.cable.stall()
                await asyncio.sleep(lasts_s)
                await line.cable.go_on()
            case "corrupt":
                line.is_bad = True
                await asyncio.sleep(lasts_s)
                line.is_bad = False
            case "noise":
                line.inject(int(order["bytes"]))
            case "reset":
                self.yard.reset(at, now_ns=self._now_ns())
            case "wander":
                lines = {self._wander(at)}
            case "reboot":
                node = await self._reboot(at)
                lines = set() if node is None else {self.yard.home_of(node)}
                if node is None:
                    _tell({"ended": number, "is_void": True})
                    return
            case _:
                raise ValueError(f"order {what!r} is none")
        _tell({"ended": number})
        self._watches.append(_Watch(order=number, since_ns=self._now_ns(), lines=lines, node=node))

    def _wander(self, at: int) -> int:
        """Let a tenth of a dongle's biobots go to another one; return which."""
        others = [one for one in range(len(self.lines)) if one != at]
        chosen = self.random.choice(others)
        here = [node for node in self.yard.nodes if self.yard.home_of(node) == at]
        for node in self.random.sample(here, max(1, len(here) // 10)) if here else ():
            self.yard.move(node, chosen, now_ns=self._now_ns())
        return chosen

    async def _reboot(self, at: int) -> NodeId | None:
        """Let a biobot of a dongle finish what it has to tell and then start anew; None where it cannot finish in time."""
        here = [node for node in self.yard.nodes if self.yard.home_of(node) == at]
        if not here:
            return None
        node = self.random.choice(here)
        self.yard.leave(node)
        deadline_ns = self._now_ns() + round(_LONGEST_LEAVE_S * NS_PER_S)
        while not self.yard.can_restart(node, now_ns=self._now_ns()):
            if self._now_ns() > deadline_ns or self.yard.has_stopped:
                self.yard.stay(node)
                return None
            await asyncio.sleep(_LOOK_S)
        self.yard.restart(node, now_ns=self._now_ns())
        return node

    def _feeder(self, at: int) -> Callable[[bytes], None]:
        def feed(data: bytes) -> None:
            self.yard.feed(data, dongle=at, now_ns=self._now_ns())
            self._wake.set()

        return feed

    def _now_ns(self) -> int:
        return time.monotonic_ns() - self.config.t0_ns


async def _serve(config: YardConfig) -> None:
    specs = [parse_line(line) for line in config.lines]
    ends = [TroubledEnd(await open_line(spec), seed=config.seed, number=config.dongles_before + at) for at, spec in enumerate(specs)]
    with Ledger(Path(config.directory) / "ledger.bin") as ledger:
        yard = Yard(config, dialects=[spec.dialect for spec in specs], ledger=ledger)
        await YardProcess(config=config, yard=yard, lines=tuple(ends), random=random.Random(config.seed + config.dongles_before)).run()


def _tell(news: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(news) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    set_up_logging()
    asyncio.run(_serve(msgspec.json.decode(Path(sys.argv[1]).read_bytes(), type=YardConfig)))
