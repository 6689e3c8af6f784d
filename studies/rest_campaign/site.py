"""Whom to ask: a mapper of a whole site whose insects walk, or one that is alone; both let through as many requests as come."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from mapper.access import Role, add_token
from studies.ports import free_port
from studies.rest_campaign.askers import Target
from studies.system import RunningSystem, SystemSettings

_CONFIG: Final = """\
[limits]
reads_per_s = 1e6
reads_burst = 1e6
writes_per_s = 1e6
writes_burst = 1e6
"""
_MAP_S: Final = 120.0


@contextmanager
def running_site(directory: Path, *, seed: int, duration_s: float, n_biobots: int) -> Iterator[Target]:
    """Yield a mapper with a map; its insects walk for ``duration_s``."""
    system, tokens = _prepare(directory, seed=seed, duration_s=duration_s, n_biobots=n_biobots)
    with system:
        system.wait_for(lambda: system.get("/api/v1/maps").get("maps"), what="a map", timeout_s=_MAP_S)
        yield Target(url=system.url, tokens=tokens)


@contextmanager
def lonely_mapper(directory: Path) -> Iterator[Target]:
    """Yield a mapper that has neither a gateway nor a map."""
    system, tokens = _prepare(directory, seed=1, duration_s=1.0, n_biobots=1)
    system.bus_endpoint = f"tcp/127.0.0.1:{free_port()}"
    try:
        system.start_mapper()
        yield Target(url=system.url, tokens=tokens)
    finally:
        system.stop()


def _prepare(directory: Path, *, seed: int, duration_s: float, n_biobots: int) -> tuple[RunningSystem, Mapping[Role, str]]:
    directory.mkdir(parents=True, exist_ok=True)
    config = directory / "mapper.toml"
    config.write_text(_CONFIG, encoding="utf-8")
    settings = SystemSettings(
        out=directory,
        seed=seed,
        n_biobots=n_biobots,
        dispersion_s=3.0,
        exploration_s=duration_s,
        mapper_args=("--config", str(config), "--min-interval-s", "3"),
    )
    tokens = {role: add_token(directory / "tokens.json", name=f"the {role}", role=role).text for role in Role}
    return RunningSystem(settings=settings, token=tokens[Role.OPERATOR]), tokens
