"""Install or upgrade the services: all is checked first; a new version that does not come up gives way to the one before."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from gateway.errors import InstallationError
from gateway.installation.changes import AppliedChanges
from gateway.installation.checks import check_addresses, check_programs, check_room
from gateway.installation.data_copies import DataCopy, outdated_data
from gateway.installation.layout import RULES, SERVICES, Wishes
from gateway.installation.machine import Machine
from gateway.installation.plan import Plan, plan_installation, remove_programs
from gateway.installation.record import Record, read_record

Tell = Callable[[str], None]

_SETTLING_S = 3.0
"""So long a service that said it serves must go on before it counts as up."""


@dataclass(slots=True, kw_only=True)
class _Upgrade:
    """All that is needed to go on with, or to take back, one installation on this machine."""

    machine: Machine
    before: Record | None
    after: Record
    was_running: tuple[str, ...]
    tell: Tell
    applied: AppliedChanges | None = None
    copies: list[DataCopy] = field(default_factory=list)

    @property
    def is_upgrade(self) -> bool:
        """Whether there is something to go back to."""
        return self.before is not None and (self.before.programs, self.before.version) != (self.after.programs, self.after.version)


def install_below(root: Path, wishes: Wishes, *, version: str) -> Plan:
    """Write the files below a folder, as for an image; users are made by systemd at its first boot. Returns what was done."""
    plan = plan_installation(root, wishes, record=read_record(root), version=version)
    AppliedChanges(plan.changes, root=root)
    return plan


def install(wishes: Wishes, *, version: str, starts: bool, tell: Tell) -> None:
    """Install the services on this machine, or upgrade them.

    Raises
    ------
    InstallationError
        Something must be done first, and nothing was changed; or a new version did not come up, and the one before is back.
    """
    machine = Machine()
    before = read_record(Path("/"))
    services = (*(before.services if before else ()), *wishes.services)
    check_programs(wishes.programs, services=tuple(dict.fromkeys(services)))
    check_room(Path("/"))
    plan = plan_installation(Path("/"), wishes, record=before, version=version)
    assert plan.record is not None
    was_running = machine.running()
    for name in was_running if before else ():
        if problems := machine.problems_of(SERVICES[name], programs=Path(wishes.programs)):
            reason = f"version {version} finds faults in it: {'; '.join(problems)}"
            next_step = "nothing was changed; correct it first"
            raise InstallationError(what=str(SERVICES[name].configuration), reason=reason, next_step=next_step)
    run = _Upgrade(machine=machine, before=before, after=plan.record, was_running=was_running, tell=tell)
    if not plan.changes and not run.is_upgrade:
        tell(f"version {version} is installed as it should be; nothing was changed")
    _change(run, plan)
    for note in plan.notes:
        tell(note)
    if starts and (plan.changes or run.is_upgrade):
        _start_all(run)
    for copy in run.copies:
        copy.forget()
    if before is not None and before.previous is not None and before.previous not in {plan.record.programs, plan.record.previous}:
        AppliedChanges(remove_programs(Path("/"), PurePosixPath(before.previous)), root=Path("/"))


def _change(run: _Upgrade, plan: Plan) -> None:
    """Make the changes, and have systemd and udev know of them; all of it or nothing."""
    if run.is_upgrade:
        run.copies = outdated_data(run.after.services, programs=PurePosixPath(run.after.programs))
    try:
        if run.copies:
            run.tell("the new version writes data in a newer form; a copy is kept until it is up")
            for name in reversed(run.was_running):
                run.machine.stop(SERVICES[name])
            for copy in run.copies:
                copy.make()
        run.applied = AppliedChanges(plan.changes, root=plan.root)
        os.sync()  # a base station may lose its power any moment
        run.machine.make_user()
        run.machine.make_data_folders([SERVICES[name] for name in run.after.services])
        run.machine.read_units()
        if any(change.path == RULES for change in plan.changes):
            run.machine.read_rules()
    except InstallationError:
        _go_back(run, restarts=bool(run.copies))
        raise


def _start_all(run: _Upgrade) -> None:
    """Restart what ran, and start what is new and has all that it needs."""
    known = run.before.services if run.before is not None else ()
    up: list[str] = []
    obstacles = check_addresses(run.after.services, running=run.was_running)
    for problem in obstacles:
        run.tell(problem)
    for name in run.after.services:
        service = SERVICES[name]
        if name not in run.was_running and name in known:
            run.tell(f"{service.unit} did not run, and is left so; systemctl start {service.unit} starts it")
            continue
        if name not in run.was_running and _is_held_up(run, name, obstacles):
            continue
        if not _comes_up(run, name):
            words = run.machine.last_words(service)
            if not run.is_upgrade:
                reason = f"did not come up: {words}"
                raise InstallationError(what=service.unit, reason=reason, next_step=f"correct it, then: systemctl restart {service.unit}")
            _give_way(run, name, words)
        up.append(name)
    if up:
        run.tell(f"up, with version {run.after.version}: {', '.join(up)}")


def _is_held_up(run: _Upgrade, name: str, obstacles: list[str]) -> bool:
    """Tell what a new service waits for before it can be started, if anything."""
    service = SERVICES[name]
    problems = run.machine.problems_of(service, programs=Path(run.after.programs))
    for problem in problems:
        run.tell(f"{service.unit} is not started: {problem}")
    if problems:
        run.tell(f"edit {service.configuration}, then: systemctl start {service.unit}")
    return bool(problems) or any(name in problem.split(" listen on ")[0] for problem in obstacles)


def _comes_up(run: _Upgrade, name: str) -> bool:
    """Start a service; returns whether it serves, and goes on to."""
    service = SERVICES[name]
    run.tell(f"starting {service.unit}")
    if not run.machine.start(service):
        return False
    process, deadline = run.machine.show(service, "MainPID"), time.monotonic() + _SETTLING_S
    while time.monotonic() < deadline:
        if (run.machine.show(service, "ActiveState"), run.machine.show(service, "MainPID")) != ("active", process):
            return False
        time.sleep(0.2)
    return True


def _give_way(run: _Upgrade, name: str, words: str) -> None:
    """Put the version before back, and say plainly how it stands; always raises."""
    assert run.before is not None
    down = _go_back(run, restarts=True)
    now = (
        f"version {run.before.version} runs again" if not down else f"nor did version {run.before.version}: {', '.join(down)} does not run"
    )
    raise InstallationError(
        what=SERVICES[name].unit,
        reason=f"version {run.after.version} did not come up ({words}); {now}",
        next_step="journalctl has the whole of it" if not down else "journalctl tells why; your data are in /var/lib/biobot as they were",
    )


def _go_back(run: _Upgrade, *, restarts: bool) -> list[str]:
    """Put units, data and services back as they were; returns the services that ran and do not now."""
    if restarts:
        for name in reversed(run.after.services):
            run.machine.stop(SERVICES[name])
    if run.applied is not None:
        run.applied.take_back()
    for copy in run.copies:
        copy.put_back()
    run.machine.read_units()
    if not restarts:
        return []
    run.tell("putting the version before back")
    return [name for name in run.was_running if not _comes_up(run, name)]
