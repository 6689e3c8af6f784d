"""Certificates, configuration files and services of the topology: everything that stands on its machines."""

import json
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from firmware_protocol.contract.access import parse_identity
from firmware_protocol.contract.sessions import TlsTable
from gateway.certificates import Authority, folder_of
from mapper.access import Role, add_token
from studies.campaign.services import Service
from studies.sites.page import Page
from studies.sites.plan import BETWEEN_ROUTERS, ROUTERS, SITES, GatewayPlan, SitePlan, page_cable
from studies.sites.wires import Cable, Wires

BUS_PORT: Final = 7447
_PAGE_PORT: Final = 8080
_DAYS: Final = 30


class Registry:
    """An authority in a directory, and what it has issued."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._authority = Authority.init(directory, name="sites", days=10 * _DAYS, now=datetime.now(UTC))

    @property
    def roster(self) -> Path:
        """The file of all that routers heed."""
        return self.directory / "roster.txt"

    def table(self, common_name: str, *, hosts: Sequence[str] = (), age_days: int = 0) -> TlsTable:
        """Return the TLS table of somebody, whose certificate is issued; one that is older than `_DAYS` is out of date."""
        identity = parse_identity(common_name)
        self._authority.issue(identity, hosts=hosts, days=_DAYS, now=datetime.now(UTC) - timedelta(days=age_days))
        return self.known(common_name)

    def known(self, common_name: str) -> TlsTable:
        """Return the TLS table of somebody whose certificate has been issued."""
        folder = folder_of(self.directory, parse_identity(common_name))
        return TlsTable(ca=str(folder / "ca.pem"), certificate=str(folder / "certificate.pem"), key=str(folder / "key.pem"))


def router_service(name: str, *, out: Path, wires: Wires, registry: Registry, tls: TlsTable, joins: Cable | None) -> Service:
    """Return a router that heeds whom the registry has issued to; ``joins`` is its cable to the router that it joins, itself first."""
    place = out / name
    place.mkdir(parents=True, exist_ok=True)
    connect = [f"tls/{wires.address(joins[1], cable=joins)}:{BUS_PORT}"] if joins else []
    top: dict[str, object] = {"listen": [f"tls/0.0.0.0:{BUS_PORT}"], "connect": connect, "roster": str(registry.roster)}
    config = write_toml(place / "router.toml", {"": top, "tls": as_table(tls)})
    arguments = ["gateway", "router", "--config", str(config)]
    return Service(name=name, arguments=arguments, prefix=wires.prefix(name), environment={}, log=place / "log")


class House:
    """Makes the services; each has a directory of its own under ``out``."""

    def __init__(self, *, out: Path, wires: Wires, registry: Registry) -> None:
        self.out = out
        self.wires = wires
        self.registry = registry
        self._tables = {name: registry.table(f"*/router/{name}", hosts=wires.addresses(name)) for name in ROUTERS}
        for site in SITES:
            for one in site.gateways:
                self._tables[one.host] = registry.table(f"{site.name}/gateway/{one.name}")
            addresses = [wires.address(site.mapper_host, cable=page_cable(site))]
            self._tables[site.mapper_host] = registry.table(f"{site.name}/mapper/{site.mapper}", hosts=addresses)

    def endpoint(self, router: str, *, cable: Cable) -> str:
        """Return where a router is found over a cable."""
        return f"tls/{self.wires.address(router, cable=cable)}:{BUS_PORT}"

    def router(self, name: str) -> Service:
        """Return a router; the first one joins the second."""
        joins = BETWEEN_ROUTERS if name == BETWEEN_ROUTERS[0] else None
        return router_service(name, out=self.out, wires=self.wires, registry=self.registry, tls=self._tables[name], joins=joins)

    def gateway(self, site: SitePlan, plan: GatewayPlan, *, dongle: str) -> Service:
        """Return a gateway that is connected to the router of its plan."""
        self.connect_gateway(site, plan, router=plan.router, dongle=dongle)
        return self._service(plan.host, ["gateway", "run", "--config", str(self._place(plan.host) / "gateway.toml")])

    def connect_gateway(self, site: SitePlan, plan: GatewayPlan, *, router: str, dongle: str) -> None:
        """Write a gateway's configuration file: it is connected to this router from its next start on."""
        top: dict[str, object] = {
            "site": site.name,
            "name": plan.name,
            "ports": [dongle],
            "journal": str(self.journal(plan)),
            "listen": [],
            "connect": [self.endpoint(router, cable=(plan.host, router))],
        }
        write_toml(self._place(plan.host) / "gateway.toml", {"": top, "tls": self._tls(plan.host)})

    def mapper(self, site: SitePlan) -> tuple[Service, Page]:
        """Return a site's mapper, and how it is asked."""
        place, host = self._place(site.mapper_host), site.mapper_host
        address = self.wires.address(host, cable=page_cable(site))
        tls = self._tls(host)
        serve = {
            "site": site.name,
            "name": site.mapper,
            "connect": [self.endpoint(site.mapper_router, cable=(host, site.mapper_router))],
            "store": str(self.store(site)),
            "host": address,
            "port": _PAGE_PORT,
            "allow_remote": True,
            "tokens": str(place / "tokens.json"),
            "certificate": tls["certificate"],
            "key": tls["key"],
            "min_interval_s": 5.0,
        }
        config = write_toml(place / "mapper.toml", {"serve": serve, "tls": tls})
        token = add_token(place / "tokens.json", name="operator", role=Role.OPERATOR).text
        page = Page(url=f"https://{address}:{_PAGE_PORT}", token=token, ca=Path(str(tls["ca"])))
        return self._service(host, ["mapper", "serve", "--config", str(config)]), page

    def swarm(self, site: SitePlan, *, speed: float) -> Service:
        """Return a site's swarm, with a dongle for each gateway, which listens on the cable to that gateway."""
        place = self._place(f"{site.name}-swarm")
        links = [
            word
            for one in site.gateways
            for word in ("--link", f"tcp:{self.wires.address('hall', cable=('hall', one.host))}:0")
        ]  # fmt: skip
        arguments = [
            "simulator", "serve", *links, "--scenario", "no-obstacle", "--preset", "paper-units", "--biobots", str(site.n_biobots),
            "--seed", str(site.seed), "--speed", str(speed), "--drain-s", "60",
            "--out", str(self.truth(site)), "--ready-file", str(place / "ready"),
        ]  # fmt: skip
        return self._service(place.name, arguments, host="hall")

    def dongles(self, site: SitePlan) -> list[str]:
        """Return where each gateway of a site finds its dongle; empty: the swarm is not there yet."""
        ready = self.out / f"{site.name}-swarm" / "ready"
        return ready.read_text(encoding="utf-8").split() if ready.exists() else []

    def journal(self, plan: GatewayPlan) -> Path:
        """Return where a gateway's journal is."""
        return self.out / plan.host / "journal.sqlite"

    def store(self, site: SitePlan) -> Path:
        """Return where a mapper's store is."""
        return self.out / site.mapper_host / "store.sqlite"

    def truth(self, site: SitePlan) -> Path:
        """Return where a swarm writes what truly happened."""
        return self.out / f"{site.name}-swarm" / "truth"

    def _tls(self, who: str) -> dict[str, object]:
        return as_table(self._tables[who])

    def _place(self, name: str) -> Path:
        place = self.out / name
        place.mkdir(parents=True, exist_ok=True)
        return place

    def _service(self, name: str, arguments: list[str], *, host: str | None = None) -> Service:
        prefix = self.wires.prefix(host or name)
        return Service(name=name, arguments=arguments, prefix=prefix, environment={}, log=self.out / name / "log")


def as_table(tls: TlsTable) -> dict[str, object]:
    """Return a TLS table as a configuration file has it."""
    return {"ca": tls.ca, "certificate": tls.certificate, "key": tls.key}


def write_toml(path: Path, tables: dict[str, dict[str, object]]) -> Path:
    """Write a TOML file; a table without a name is the top of it."""
    lines = []
    for table, values in tables.items():
        lines += [f"[{table}]"] if table else []
        lines += [f"{key} = {json.dumps(value)}" for key, value in values.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
