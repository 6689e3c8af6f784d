"""A whole site to ask: insects that walk, a gateway, and a mapper that lets through as many requests as come."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from mapper.access import Role, add_token
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
    with RunningSystem(settings=settings, token=tokens[Role.OPERATOR]) as system:
        system.wait_for(lambda: system.get("/api/v1/maps").get("maps"), what="a map", timeout_s=_MAP_S)
        yield Target(url=system.url, tokens=tokens)
