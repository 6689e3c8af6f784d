"""``biobot-gateway certs``: a private authority, and certificates for the services of a site."""

import argparse
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from firmware_protocol.contract.access import Identity, Role, parse_identity
from firmware_protocol.contract.keys import ANY
from gateway.commands.outcome import DONE, FAILED, complain, warn
from gateway.obstacles import PLACEHOLDER
from gateway.tls_files import EXPIRES_SOON_DAYS

_CA_DAYS = 3650
_DAYS = 398
_ROUTERS = f"/{Role.ROUTER.value}/"
_SITE = "local"
"""What configurations have by default, too."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``init``, ``issue``, ``show`` and ``check``."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    init = actions.add_parser("init", help="make an authority in a directory")
    issue = actions.add_parser("issue", help="issue a certificate and print the configuration to paste; enters it on the roster")
    show = actions.add_parser("show", help="list all certificates with their ends")
    check = actions.add_parser("check", help="the same; exit status 1 where one is unfit or ends soon")
    for one in (init, issue, show, check):
        one.add_argument("directory", type=Path, metavar="DIR", help="directory of the authority; keep it on one machine")
    init.add_argument("--name", default="biobot authority", help="its name in the certificates (default: biobot authority)")
    init.add_argument("--days", type=int, default=_CA_DAYS, metavar="N", help=f"how long it lasts (default: {_CA_DAYS})")
    issue.add_argument("role", choices=[role.value for role in Role])
    issue.add_argument("name", help="the service's own name, as in its configuration; an operator's or viewer's for people")
    issue.add_argument("--site", help="its site (default: local; for a router: all sites)")
    issue.add_argument("--all-sites", action="store_true", help="welcome at all sites")
    issue.add_argument(
        "--host",
        action="append",
        metavar="HOST",
        default=[],
        help="name or address that others connect to, which a router needs; repeatable",
    )
    issue.add_argument("--days", type=int, default=_DAYS, metavar="N", help=f"how long it lasts (default: {_DAYS})")
    issue.add_argument("--renew", action="store_true", help="replace the one there is, which is kept as .old")


def certs(options: argparse.Namespace) -> int:
    """Do what was asked of the authority."""
    from gateway import certificates  # noqa: PLC0415  # cryptography takes a while to load, which --help does not need

    now = datetime.now(UTC)
    if options.action == "init":
        certificates.Authority.init(options.directory, name=options.name, days=options.days, now=now)
        print(f"authority in {options.directory}; next: biobot-gateway certs issue {options.directory} router main --host ADDRESS")
        return DONE
    if options.action == "issue":
        authority = certificates.Authority.open(options.directory)
        identity = _identity(options, sites=authority.sites())
        folder = authority.issue(identity, hosts=options.host, days=options.days, now=now, renew=options.renew)
        known = certificates.list_certificates(options.directory, now=now)
        reached = [host for one in known if _ROUTERS in one.identity for host in one.hosts if "*" not in host]
        router = f"tls/{_bracketed(reached[0]) if reached else PLACEHOLDER}:7447"
        print(paste(identity, folder=folder.resolve(), roster=(options.directory / "roster.txt").resolve(), router=router))
        return DONE
    found = certificates.list_certificates(options.directory, now=now)
    is_fit = True
    for one in found:
        days = one.days_left(now)
        told = [*one.problems, *([] if one.is_on_roster else ["not on the roster: routers refuse it"])]
        if 0 <= days < EXPIRES_SOON_DAYS:
            told.append("ends soon: renew it with --renew")
        is_fit = is_fit and not told
        hosts = f" hosts {', '.join(one.hosts)}" if one.hosts else ""
        print(f"{one.identity}: until {one.not_after:%Y-%m-%d} ({days:.0f} days){hosts}{''.join(f'; {text}' for text in told)}")
    return FAILED if options.action == "check" and not is_fit else DONE


def paste(identity: Identity, *, folder: Path, roster: Path, router: str) -> str:
    """Return the configuration of a service that shows this certificate and connects to a router."""
    lines = [f"# for {identity.common_name}; copy {folder} to its machine, or its paths into these lines"]
    if identity.role is Role.ROUTER:
        lines += ['listen = ["tls/0.0.0.0:7447"]', f"roster = {_quoted(roster)}"]
    elif identity.role is Role.GATEWAY:
        lines += [f'site = "{identity.site}"', f'name = "{identity.name}"', "listen = []", f'connect = ["{router}"]']
    elif identity.role is Role.MAPPER:
        lines += ["[serve]", f'site = "{identity.site}"', f'name = "{identity.name}"', f'connect = ["{router}"]']
    else:
        site = [] if identity.site == ANY else [f'site = "{identity.site}"']
        lines += ["# biobot-gateway command|status --config FILE, with these lines in FILE", *site, f'connect = ["{router}"]']
    lines += ["[tls]"]
    lines += [
        f"{key} = {_quoted(folder / name)}" for key, name in (("ca", "ca.pem"), ("certificate", "certificate.pem"), ("key", "key.pem"))
    ]
    return "\n".join(lines)


def _identity(options: argparse.Namespace, *, sites: Sequence[str]) -> Identity:
    """Return whom the certificate is to name; ``sites``: those that others of this authority are of."""
    name = f"{options.role}/{options.name}"
    if options.all_sites or (options.role == Role.ROUTER.value and options.site is None):
        return parse_identity(f"{ANY}/{name}")
    if options.site is not None:
        return parse_identity(f"{options.site}/{name}")
    complain(f"no --site: it is for site {_SITE}, which services are of where their configuration names none")
    if sites and _SITE not in sites:
        warn([f"the others of this authority are of site {' or '.join(sites)}, and do not hear it: --site {sites[0]} if it belongs there"])
    return parse_identity(f"{_SITE}/{name}")


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _quoted(path: Path) -> str:
    return '"' + str(path).replace("\\", "\\\\").replace('"', '\\"') + '"'
