"""The shortest of it, for the suite: a gateway's journal and bus behind one router, a mapper's intake and store behind the other.

Over TLS, with access control, in namespaces. The cable between the routers swallows what it carries for a while, then the gateway's router
is killed and started again; meanwhile strangers try what they can. What is looked for is that the store comes to have all that was
published, and that the strangers get nothing.
"""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import msgspec

from studies.campaign.director import wait_until
from studies.campaign.services import Service
from studies.cut_link_ends import MAPPER, SITE
from studies.errors import SitesError
from studies.sites.house import Registry, router_service
from studies.sites.strangers import StrangersPlan, problems_with_stranger, try_strangers
from studies.sites.wires import HALL, Cable, Wires

_GATEWAY: Final = "gateway1"
_PERIOD_S: Final = 0.01
_LIMIT_S: Final = 200.0
_ATTEMPTS: Final = 20
_MORE: Final = 50
"""Records that are published while something is out of order."""

_HERE: Final[Cable] = ("r1", "g")
_BETWEEN: Final[Cable] = ("r1", "r2")
_THERE: Final[Cable] = ("r2", "m")
_DOOR: Final[Cable] = ("r1", HALL)


async def run_short(out: Path) -> dict[str, Any]:
    """Run it; return how many records were published and stored, what strangers were told, and the problems.

    Raises
    ------
    SitesError
        Something was not there in time.
    """
    with Wires((_HERE, _BETWEEN, _THERE, _DOOR)) as wires:
        short = _Short(out=out, wires=wires)
        try:
            return await short.live()
        finally:
            short.close()


class _Short:
    def __init__(self, *, out: Path, wires: Wires) -> None:
        self._out = out
        self._wires = wires
        registry = Registry(out / "pki")
        self._registry = registry
        tables = {name: registry.table(f"*/router/{name}", hosts=wires.addresses(name)) for name in _BETWEEN}
        self._tables = {"g": registry.table(f"{SITE}/gateway/{_GATEWAY}"), "m": registry.table(f"{SITE}/mapper/{MAPPER}")}
        self._strangers = {"other site": registry.table(f"barn/gateway/{_GATEWAY}")}
        self._routers = {
            name: router_service(name, out=out, wires=wires, registry=registry, tls=tables[name], joins=joins)
            for name, joins in (("r1", _BETWEEN), ("r2", None))
        }
        self._ends = {"g": self._end("publisher", "g", _HERE), "m": self._end("subscriber", "m", _THERE)}

    async def live(self) -> dict[str, Any]:
        for service in (*self._routers.values(), self._ends["g"]):
            service.start()
        await self._wait((self._out / "journal.txt").exists, what="the publisher's journal")
        late = self._registry.table(f"{SITE}/mapper/late")  # on the roster after the routers have read it
        self._ends["m"].start()
        await self._wait(lambda: self._level() > 0, what="the first record is in the store")
        door = f"tls/{self._wires.address('r1', cable=_DOOR)}:7447"
        tables = {**self._strangers, "not on the roster": late}
        plan = StrangersPlan(endpoint=door, site=SITE, gateway=_GATEWAY, seconds=0.0, tables=tables, attempts=_ATTEMPTS)
        prefix, file = self._wires.prefix(HALL), self._out / "strangers.json"
        attempts = asyncio.create_task(asyncio.to_thread(try_strangers, plan, prefix=prefix, file=file))
        self._wires.swallow(_BETWEEN)
        await self._publish_more()
        self._wires.pass_on(_BETWEEN)
        told = await attempts
        self._routers["r1"].kill()
        await self._publish_more()
        self._routers["r1"].start()
        await self._publish_more()
        wanted = self._published()
        await self._wait(lambda: self._level() >= wanted, what=f"all {wanted} records are in the store")
        problems = [problem for one in told for problem in problems_with_stranger(one, may_hear=False)]
        problems += [f"stranger ({one['name']}) never came as far as to try" for one in told if not one["is_connected"]]
        return {"published": wanted, "stored": self._level(), "strangers": told, "problems": problems}

    def close(self) -> None:
        """End what still runs."""
        for service in (*self._ends.values(), *self._routers.values()):
            service.kill()

    async def _publish_more(self) -> None:
        wanted = self._published() + _MORE
        await self._wait(lambda: self._published() >= wanted, what=f"{_MORE} more records are journaled")

    async def _wait(self, claim: Callable[[], bool], *, what: str) -> None:
        if not await wait_until(claim, timeout_s=_LIMIT_S):
            raise SitesError(f"{what}: not after {_LIMIT_S:g} s; the logs are in {self._out}")

    def _end(self, role: str, host: str, cable: Cable) -> Service:
        table = self._out / f"{host}.json"
        table.write_bytes(msgspec.json.encode(self._tables[host]))
        endpoint = f"tls/{self._wires.address(cable[0], cable=cable)}:7447"
        arguments = ["studies.cut_link_ends", role, endpoint, str(self._out / f"{role}.log"), str(_PERIOD_S), str(table)]
        return Service(name=role, arguments=arguments, prefix=self._wires.prefix(host), environment={}, log=self._out / f"{role}.err")

    def _published(self) -> int:
        return _last(self._out / "publisher.log")

    def _level(self) -> int:
        return _last(self._out / "subscriber.log")


def _last(log: Path) -> int:
    """Return the newest offset that an end has noted; 0: none yet."""
    lines = [line for line in log.read_text(encoding="utf-8").splitlines() if line.endswith("]")] if log.exists() else []
    return int(json.loads(lines[-1])[0]) if lines else 0
