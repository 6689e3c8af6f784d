"""``biobot-gateway install-service`` and ``uninstall-service``: the services of this machine, under systemd."""

import argparse
import sys
from importlib.metadata import version
from pathlib import Path, PurePosixPath

from gateway.commands.outcome import DONE, FAILED, complain
from gateway.errors import InstallationError
from gateway.installation.changes import describe
from gateway.installation.checks import warn_of_missing
from gateway.installation.install import install, install_below
from gateway.installation.layout import CONFIGURATION, DATA, Wishes, choose_services
from gateway.installation.plan import Plan, plan_installation, plan_removal
from gateway.installation.record import read_record
from gateway.installation.rehearsal import rehearse
from gateway.installation.remove import remove, remove_below

_SERVICES = "gateway,mapper"


def add_install_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``install-service``."""
    parser.add_argument("--services", metavar="LIST", default=_SERVICES, help=f"of gateway, mapper, router (default: {_SERVICES})")
    parser.add_argument("--port", action="append", metavar="SPEC", default=[], help="a radio, for a gateway.toml that is made; repeatable")
    parser.add_argument("--site", help="name of the site, for configurations that are made (default: local)")
    parser.add_argument("--name", help="name of the gateway, for a gateway.toml that is made (default: base1)")
    parser.add_argument("--no-start", action="store_true", help="start nothing now; at the next boot it is")
    help_text = "virtual environment that the units start (default: that of this program, if it is below --root)"
    parser.add_argument("--programs", type=Path, metavar="DIR", help=help_text)
    _add_common(parser)


def add_uninstall_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``uninstall-service``."""
    parser.add_argument("--purge", action="store_true", help="remove data, configurations and the user too")
    parser.add_argument("--yes", action="store_true", help="do not ask before data are removed")
    _add_common(parser)


def install_service(options: argparse.Namespace) -> int:
    """Install or upgrade, or say what that would do."""
    wishes = Wishes(
        services=choose_services(options.services),
        programs=_programs(options.root, options.programs),
        ports=tuple(options.port),
        site=options.site,
        name=options.name,
    )
    ours = version("biobot-gateway")
    if options.root is not None:
        complain(*warn_of_missing(_root(options), wishes.programs, services=wishes.services))
    if options.dry_run:
        plan = plan_installation(_root(options), wishes, record=read_record(_root(options)), version=ours)
        _print_all([*map(describe, plan.changes), *plan.notes])
        return DONE if options.root is not None else _rehearse(plan)
    if options.root is not None:
        _print_all(install_below(options.root, wishes, version=ours).notes)
    else:
        install(wishes, version=ours, starts=not options.no_start, tell=_tell)
    return DONE


def _rehearse(plan: Plan) -> int:
    """Say what the installation would be refused for, and what would keep services from being started."""
    found = rehearse(plan)
    _print_all(found.notes)
    return complain(*(f"would be refused: {refusal}" for refusal in found.refusals), status=FAILED if found.refusals else DONE)


def uninstall_service(options: argparse.Namespace) -> int:
    """Remove, or say what that would remove."""
    if options.dry_run:
        plan = plan_removal(_root(options), record=read_record(_root(options)), purges=options.purge)
        _print_all([*map(describe, plan.changes), *plan.notes] or [f"no service of biobot is installed below {_root(options)}"])
        return DONE
    if options.purge and not options.yes and not _agrees():
        return complain("nothing was removed", status=FAILED)
    if options.root is not None:
        _print_all(remove_below(options.root, purges=options.purge).notes)
    else:
        remove(purges=options.purge, tell=_tell)
    return DONE


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--root", type=Path, metavar="DIR", help="work on the system below DIR, such as an image's; nothing is started")
    parser.add_argument("--dry-run", action="store_true", help="say what would be done; change nothing")


def _root(options: argparse.Namespace) -> Path:
    return options.root or Path("/")


def _programs(root: Path | None, programs: Path | None) -> PurePosixPath:
    """Return how the installed system names the folder of programs."""
    here = (programs or Path(sys.prefix)).absolute()
    if root is None:
        return PurePosixPath(here)
    if here.is_relative_to(root.absolute()):
        return PurePosixPath("/") / here.relative_to(root.absolute())
    if programs is None:
        next_step = "name the folder of programs as that system will, as with --programs /opt/biobot/VERSION"
        raise InstallationError(what=f"this program's own folder, {here}", reason=f"is not below {root}", next_step=next_step)
    return PurePosixPath(here)


def _agrees() -> bool:
    if not sys.stdin.isatty():
        complain(f"--purge removes {DATA} and {CONFIGURATION} for good: give --yes, as nobody is here to be asked")
        return False
    return input(f"{DATA} and {CONFIGURATION} are removed for good, journals too. Type yes: ").strip() == "yes"


def _tell(line: str) -> None:
    print(line, flush=True)


def _print_all(lines: list[str]) -> None:
    for line in lines:
        print(line)
