"""What an installation on this machine would be refused for, and which services it would not start, and why; nothing is changed."""

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from gateway.errors import InstallationError
from gateway.installation.checks import check_addresses, check_programs, check_room, missing_programs
from gateway.installation.layout import SERVICES, USER
from gateway.installation.machine import Machine, has_user, problems_of, running_services
from gateway.installation.plan import Plan


@dataclass(slots=True, kw_only=True)
class Rehearsal:
    """Errors that would end the installation before anything is changed, and what keeps services from being started after it."""

    refusals: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def rehearse(plan: Plan) -> Rehearsal:
    """Do the checks of `install` for what is planned, all of them, whoever asks."""
    assert plan.record is not None
    services, programs, found = plan.record.services, Path(plan.record.programs), Rehearsal()

    def attempt(check: Callable[[], object]) -> bool:
        try:
            check()
        except InstallationError as error:
            found.refusals.append(str(error))
            return False
        return True

    attempt(Machine)
    attempt(lambda: check_programs(PurePosixPath(programs), services=services))
    attempt(lambda: check_room(plan.root))
    running = running_services()
    missing = missing_programs(plan.root, PurePosixPath(programs), services=services)
    for name in () if missing else services:
        problems = _problems_of(plan, name, programs=programs)
        if name in running:
            found.refusals += [f"{SERVICES[name].configuration}: {problem}; correct it first" for problem in problems]
        else:
            found.notes += [f"{SERVICES[name].unit} would not be started: {problem}" for problem in problems]
    found.notes += check_addresses(services, running=running, configuration_of=lambda name: _configuration(plan, name))
    return found


def _configuration(plan: Plan, name: str) -> bytes:
    return plan.outcome(SERVICES[name].configuration) or b""


def _problems_of(plan: Plan, name: str, *, programs: Path) -> Sequence[str]:
    service = SERVICES[name]
    there = plan.here(service.configuration)
    if there.exists():
        if os.geteuid() != 0:
            return [f"what is in {service.configuration} can be checked by root alone"]
        folder = plan.here(service.data)
        with _folder(folder) as where:
            return problems_of(
                service, programs=programs, configuration=there, folder=where, user=USER if where == folder and has_user() else None
            )
    with tempfile.TemporaryDirectory() as place:
        # Its journal or store would be made in the service's own, empty folder: here it is looked at in another one.
        draft = Path(place) / there.name
        draft.write_bytes(_configuration(plan, name))
        told = problems_of(service, programs=programs, configuration=draft, folder=Path(place), user=None)
        return [line.replace(str(draft), str(service.configuration)) for line in told]


@contextlib.contextmanager
def _folder(folder: Path) -> Iterator[Path]:
    """Yield a folder, or an empty one in its place while it is not there."""
    if folder.is_dir():
        yield folder
        return
    with tempfile.TemporaryDirectory() as place:
        yield Path(place)
