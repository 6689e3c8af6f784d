"""What an encounter, a biobot and a base station cost, measured one by one: ``python -m studies.sites.costs`` (docs/scaling.md).

In namespaces, over TLS with access control: gateways behind one router, the mapper behind another. First real services that have nothing
to do, then with many biobots that stand still, then a gateway's journal and bus and a mapper's intake and store at steady rates.
"""

import argparse
import asyncio
import contextlib
import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Final

import msgspec

from studies.campaign.director import wait_until
from studies.campaign.services import Service
from studies.campaign.surroundings import enter_namespaces
from studies.errors import SitesError
from studies.sites.cost_ends import EndPlan, read_told
from studies.sites.house import BUS_PORT, Registry, as_table, router_service, write_toml
from studies.sites.wires import HALL, Cable, Wires, find_problem

CASES: Final = ("standing", "slow", "fast", "three", "memory")

_SITE: Final = "costs"
_MAPPER: Final = "map1"
_LIMIT_S: Final = 300.0
_SETTLE_S: Final = 4.0
_MANY: Final = 100_000
_BETWEEN: Final[Cable] = ("r1", "r2")
_THERE: Final[Cable] = ("m", "r2")


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What one case took, by process: seconds of a core and bytes of memory; bytes by cable and by file."""

    case: str
    seconds: float
    n_records: int
    cpu_s: dict[str, float]
    rss: dict[str, int]
    carried: dict[str, int]
    files: dict[str, int] = field(default_factory=dict)


@dataclass(slots=True, kw_only=True)
class Bench:
    """The routers, and whatever a case puts behind them; all of it ends with the context of `open_bench`."""

    out: Path
    wires: Wires
    registry: Registry
    gateways: tuple[str, ...]
    services: dict[str, Service] = field(default_factory=dict)

    def start(self, service: Service) -> None:
        """Start a service, and end it with the bench."""
        self.services[service.name] = service
        service.start()

    def endpoint(self, cable: Cable) -> str:
        """Return where the router at the second end of a cable is found."""
        return f"tls/{self.wires.address(cable[1], cable=cable)}:{BUS_PORT}"

    def service(self, name: str, arguments: list[str], *, host: str) -> Service:
        """Return a service on a machine."""
        return Service(name=name, arguments=arguments, prefix=self.wires.prefix(host), environment={}, log=self.out / f"{name}.log")

    def snapshot(self) -> tuple[float, dict[str, float], dict[str, int]]:
        """Return instant [s], processor time by process [s] and bytes by cable."""
        cables = (*((name, "r1") for name in self.gateways), _BETWEEN, _THERE)
        carried = {" - ".join(cable): self.wires.carried(cable) for cable in cables}
        return time.monotonic(), {name: one.cpu_s() for name, one in self.services.items()}, carried

    async def measure(self, case: str, *, lasts_s: float = 0.0, until: Callable[[], int] | None = None) -> Cost:
        """Return what is used up in some time, or until all records are through."""
        begun_s, cpu_s, carried = self.snapshot()
        n_records = 0
        if until is None:
            await asyncio.sleep(lasts_s)
        else:
            await _wait(lambda: until() > 0, what=case)
            n_records = until()
        ended_s, cpu_after_s, carried_after = self.snapshot()
        return Cost(
            case=case,
            seconds=ended_s - begun_s,
            n_records=n_records,
            cpu_s={name: cpu_after_s[name] - used_s for name, used_s in cpu_s.items()},
            rss={name: one.peak_rss for name, one in self.services.items()},
            carried={name: carried_after[name] - n_bytes for name, n_bytes in carried.items()},
        )


@contextlib.contextmanager
def open_bench(out: Path, *, n_gateways: int) -> Iterator[Bench]:
    """Lay the cables and start the routers."""
    out.mkdir(parents=True)
    gateways = tuple(f"g{number + 1}" for number in range(n_gateways))
    with Wires([*((name, "r1") for name in gateways), _BETWEEN, _THERE, (HALL, "g1")]) as wires:
        registry = Registry(out / "pki")
        bench = Bench(out=out, wires=wires, registry=registry, gateways=gateways)
        try:
            tables = {name: registry.table(f"*/router/{name}", hosts=wires.addresses(name)) for name in _BETWEEN}
            registry.table(f"{_SITE}/mapper/{_MAPPER}")
            for name in gateways:
                registry.table(f"{_SITE}/gateway/{name}")
            for name in _BETWEEN:
                joins = _BETWEEN if name == _BETWEEN[0] else None
                bench.start(router_service(name, out=out, wires=wires, registry=registry, tls=tables[name], joins=joins))
            yield bench
        finally:
            for service in bench.services.values():
                service.kill()


async def cost_of_standing(out: Path, *, n_biobots: int, lasts_s: float) -> Cost:
    """Measure a real gateway and a real mapper while biobots stand still."""
    with open_bench(out, n_gateways=1) as bench:
        ready = out / "ready"
        link = f"tcp:{bench.wires.address(HALL, cable=(HALL, 'g1'))}:0"
        arguments = [
            "simulator",
            "serve",
            "--link",
            link,
            "--scenario",
            "no-obstacle",
            "--biobots",
            str(n_biobots),
            "--seed",
            "1",
            "--speed",
            "0.001",
        ]
        bench.start(bench.service("swarm", [*arguments, "--ready-file", str(ready)], host=HALL))
        await _wait(lambda: bool(ready.exists() and ready.read_text(encoding="utf-8").split()), what="the swarm")
        tls = bench.registry.known(f"{_SITE}/gateway/g1")
        top: dict[str, object] = {
            "site": _SITE,
            "name": "g1",
            "ports": ready.read_text(encoding="utf-8").split(),
            "journal": str(out / "g1.sqlite"),
            "listen": [],
            "connect": [bench.endpoint(("g1", "r1"))],
        }
        bench.start(
            bench.service(
                "gateway", ["gateway", "run", "--config", str(write_toml(out / "g1.toml", {"": top, "tls": as_table(tls)}))], host="g1"
            )
        )
        serve: dict[str, object] = {
            "site": _SITE,
            "name": _MAPPER,
            "connect": [bench.endpoint(_THERE)],
            "store": str(out / "m.sqlite"),
            "port": 0,
        }
        url = out / "url"
        tables = {"serve": serve, "tls": as_table(bench.registry.known(f"{_SITE}/mapper/{_MAPPER}"))}
        config = write_toml(out / "m.toml", tables)
        bench.start(bench.service("mapper", ["mapper", "serve", "--config", str(config), "--url-file", str(url)], host="m"))
        await _wait(url.exists, what="the mapper")
        await asyncio.sleep(_SETTLE_S + lasts_s)  # all clocks are fitted, all biobots are known
        return await bench.measure(f"{n_biobots} biobots that stand", lasts_s=lasts_s)


async def cost_of_records(out: Path, *, n_gateways: int, rate: float, lasts_s: float) -> list[Cost]:
    """Measure gateways' journals and buses, routers and a mapper's store: idle, then at a rate [records/s of each gateway]."""
    with open_bench(out, n_gateways=n_gateways) as bench:
        n_records = round(rate * lasts_s)
        _start_publishers(bench, rate=rate, n_records=n_records)
        plan = EndPlan(
            role="subscriber",
            site=_SITE,
            name=_MAPPER,
            endpoint=bench.endpoint(_THERE),
            tls=bench.registry.known(f"{_SITE}/mapper/{_MAPPER}"),
            file=str(out / "store.sqlite"),
            told=str(out / "m.told"),
            gateways=bench.gateways,
        )
        _start_end(bench, plan, host="m")
        await _wait(lambda: all((out / f"{name}.told").exists() for name in (*bench.gateways, "m")), what="all ends")
        await asyncio.sleep(_SETTLE_S)
        idle = await bench.measure(f"{n_gateways} gateways, idle", lasts_s=lasts_s / 2)
        (out / "go").touch()
        wanted = n_records * n_gateways
        case = f"{n_gateways} gateways of {rate:g} encounters/s"
        cost = await bench.measure(case, until=lambda: wanted * (read_told(out / "m.told")[1] >= wanted))
        files = {name: _size(out, name) for name in (*bench.gateways, "store")}
        return [idle, replace(cost, files=files)]


async def cost_of_memory(out: Path, *, n_records: int, rate: float) -> list[Cost]:
    """Measure a real mapper before and after it has taken in many encounters."""
    with open_bench(out, n_gateways=1) as bench:
        _start_publishers(bench, rate=rate, n_records=n_records)
        await _wait((out / "g1.told").exists, what="the publisher")
        serve: dict[str, object] = {
            "site": _SITE,
            "name": _MAPPER,
            "connect": [bench.endpoint(_THERE)],
            "store": str(out / "store.sqlite"),
            "port": 0,
            "min_interval_s": 60.0,
        }
        tables = {"serve": serve, "tls": as_table(bench.registry.known(f"{_SITE}/mapper/{_MAPPER}"))}
        arguments = ["mapper", "serve", "--config", str(write_toml(out / "m.toml", tables)), "--url-file", str(out / "url")]
        bench.start(bench.service("mapper", arguments, host="m"))
        await _wait((out / "url").exists, what="the mapper")
        await asyncio.sleep(_SETTLE_S)
        before = await bench.measure("a mapper with nothing", lasts_s=_SETTLE_S)
        (out / "go").touch()

        def stored() -> int:
            mark = out / "g1.mark"
            return n_records * (mark.exists() and read_told(mark)[1] >= n_records)

        after = await bench.measure(f"a mapper that took in {n_records:,} encounters", until=stored)
        return [before, replace(after, files={name: _size(out, name) for name in ("g1", "store")})]


def _start_publishers(bench: Bench, *, rate: float, n_records: int) -> None:
    for name in bench.gateways:
        plan = EndPlan(
            role="publisher",
            site=_SITE,
            name=name,
            endpoint=bench.endpoint((name, "r1")),
            tls=bench.registry.known(f"{_SITE}/gateway/{name}"),
            file=str(bench.out / f"{name}.sqlite"),
            told=str(bench.out / f"{name}.told"),
            rate=rate,
            n_records=n_records,
            go=str(bench.out / "go"),
        )
        _start_end(bench, plan, host=name)


def _size(out: Path, name: str) -> int:
    return sum(path.stat().st_size for path in out.glob(f"{name}.sqlite*"))


def _start_end(bench: Bench, plan: EndPlan, *, host: str) -> None:
    file = bench.out / f"{host}.json"
    file.write_bytes(msgspec.json.encode(plan))
    bench.start(bench.service(host, ["studies.sites.cost_ends", str(file)], host=host))


async def _wait(claim: Callable[[], bool], *, what: str) -> None:
    if not await wait_until(claim, timeout_s=_LIMIT_S):
        raise SitesError(f"{what}: not after {_LIMIT_S:g} s")


def main(arguments: list[str] | None = None) -> int:
    """Measure all cases, and print what they say."""
    parser = argparse.ArgumentParser(prog="python -m studies.sites.costs", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("sites-out"), metavar="DIR", help="made anew (default: sites-out)")
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="of each case (default: 20)")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), help="(default: all)")
    options = parser.parse_args(arguments)
    enter_namespaces("studies.sites.costs")
    if (problem := find_problem()) is not None:
        sys.stderr.write(f"costs: skipped: {problem}\n")
        return 0
    out = options.out.resolve() / "costs"
    shutil.rmtree(out, ignore_errors=True)
    try:
        costs = asyncio.run(_measure_all(out, lasts_s=options.seconds, cases=options.cases))
    except SitesError as error:
        sys.stderr.write(f"costs: error: {error}\n")
        return 1
    (out / "costs.json").write_text(json.dumps([asdict(cost) for cost in costs], indent=1) + "\n", encoding="utf-8")
    sys.stdout.write(write_costs(costs))
    return 0


async def _measure_all(out: Path, *, lasts_s: float, cases: Sequence[str]) -> list[Cost]:
    costs: list[Cost] = []
    if "standing" in cases:
        costs += [await cost_of_standing(out / f"standing{n_biobots}", n_biobots=n_biobots, lasts_s=lasts_s) for n_biobots in (2, 500)]
    if "slow" in cases:
        costs += await cost_of_records(out / "slow", n_gateways=1, rate=10.0, lasts_s=lasts_s)
    if "fast" in cases:
        costs += await cost_of_records(out / "fast", n_gateways=1, rate=1000.0, lasts_s=lasts_s)
    if "three" in cases:
        costs += await cost_of_records(out / "three", n_gateways=3, rate=1000.0, lasts_s=lasts_s)
    if "memory" in cases:
        costs += await cost_of_memory(out / "memory", n_records=_MANY, rate=2000.0)
    return costs


def write_costs(costs: Sequence[Cost]) -> str:
    """Return tables in Markdown: a row of each process and cable in each case."""
    lines = ["| case | process | % of a core | us an encounter | MB |", "|---|---|---|---|---|"]
    for cost in costs:
        for name, cpu_s in cost.cpu_s.items():
            each = f"{1e6 * cpu_s / cost.n_records:.0f}" if cost.n_records else "-"
            lines.append(f"| {cost.case} | {name} | {100 * cpu_s / cost.seconds:.1f} | {each} | {cost.rss[name] / 1e6:.0f} |")
    lines += ["", "| case | cable or file | bytes/s | bytes an encounter |", "|---|---|---|---|"]
    for cost in costs:
        for name, n_bytes in {**cost.carried, **cost.files}.items():
            each = f"{n_bytes / cost.n_records:.0f}" if cost.n_records else "-"
            lines.append(f"| {cost.case} | {name} | {n_bytes / cost.seconds:,.0f} | {each} |")
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    sys.exit(main())
