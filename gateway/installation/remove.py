"""Remove the services: nothing of the program stays; data and configurations do, unless they are to go too."""

from pathlib import Path

from gateway.installation.changes import AppliedChanges
from gateway.installation.install import Tell
from gateway.installation.layout import CONFIGURATION, DATA, RULES, SERVICES, USER
from gateway.installation.machine import Machine
from gateway.installation.plan import Plan, plan_removal
from gateway.installation.record import read_record


def remove_below(root: Path, *, purges: bool) -> Plan:
    """Remove the files below a folder; returns what was done."""
    plan = plan_removal(root, record=read_record(root), purges=purges)
    AppliedChanges(plan.changes, root=root)
    return plan


def remove(*, purges: bool, tell: Tell) -> None:
    """Stop the services and remove them from this machine.

    Raises
    ------
    InstallationError
        It cannot be done: not root, or a file that cannot be removed.
    """
    machine = Machine()
    record = read_record(Path("/"))
    plan = plan_removal(Path("/"), record=record, purges=purges)
    if record is None and not plan.changes:
        tell("nothing is installed here")
        return
    for service in reversed(SERVICES.values()):
        if record is not None and service.name in record.services:
            machine.stop(service)
    AppliedChanges(plan.changes, root=Path("/"))
    machine.read_units()
    if any(change.path == RULES for change in plan.changes):
        machine.read_rules()
    for note in plan.notes:
        tell(note)
    if purges:
        if problem := machine.remove_user():
            tell(problem)
        tell("removed, with data and configurations")
        return
    tell(f"removed; {CONFIGURATION}, {DATA} and user {USER} stay: `rm -r {CONFIGURATION} {DATA}; userdel {USER}` takes them too")
