"""``biobot-mapper tokens``: make, list and revoke tokens in the file, whether or not the service runs."""

import argparse
import os
import sys
from datetime import UTC, datetime
from pathlib import Path

from mapper.access.register import add_token, revoke_token
from mapper.access.roles import Role
from mapper.access.token_file import read_tokens
from mapper.access.tokens import TokenRecord
from mapper.config import load_mapper_config, tokens_path

_NS_PER_S = 1_000_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tokens``."""
    parser.add_argument("what", nargs="?", choices=["add", "list", "revoke"], help="make one, list all, or revoke one")
    parser.add_argument(
        "subject", nargs="?", metavar="NAME|ID", help="add: the person's name, as audit logs will have it; revoke: the token's id"
    )
    parser.add_argument("--role", choices=[str(role) for role in Role], help="add: viewer looks, operator commands, admin makes tokens")
    parser.add_argument("--tokens", metavar="FILE", help="their file (default: as the configuration has it, or mapper-tokens.json)")
    parser.add_argument("--store", metavar="FILE", help="the store of the service, beside which the file is by default")
    parser.add_argument("--token-file", type=Path, metavar="FILE", help="add: write the token there and not to standard output")


def tokens(args: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    """Do what was asked; the service heeds it within seconds.

    Raises
    ------
    ConfigurationError, MapError
        The configuration is unfit, or the file, the name or the id cannot be used.
    """
    flags = {"serve.tokens": args.tokens, "serve.store": args.store}
    path = tokens_path(load_mapper_config(args.config, environment=os.environ, flags=flags).serve)
    if args.what == "list":
        _list(read_tokens(path) or (), path)
        return 0
    if args.what is None or args.subject is None:
        parser.error("tokens: give add NAME --role ROLE, list, or revoke ID")
    if args.what == "revoke":
        record = revoke_token(path, token_id=args.subject, keeps_admin=False)
        print(f"revoked {record.id}, {record.role} {record.name}; it opens nothing more within two seconds", file=sys.stderr)
        return 0
    if args.role is None:
        parser.error("tokens add: give --role viewer, operator or admin")
    before = read_tokens(path)
    made = add_token(path, name=args.subject, role=Role(args.role), secret_file=args.token_file)
    if args.token_file is None:
        print(made.text)
    _tell_of(made.record, path, before)
    return 0


def _tell_of(made: TokenRecord, path: Path, before: tuple[TokenRecord, ...] | None) -> None:
    """Say what was made and who heeds it, and which others open for the same name: a lost token is not replaced by a new one."""
    lines = [f"{made.role} {made.name}, id {made.id}, in {path.absolute()}; the token is shown this once"]
    if before is None:
        lines.append(
            "that file was not there before: a service heeds it whose store is in the same folder, or that is started with "
            f"--tokens {path.absolute()}; each logs at its start which file it reads (tokens=)"
        )
    lines += [
        f"{one.name} has another token, id {one.id}, {one.role}; if that is lost: biobot-mapper tokens revoke {one.id} --tokens {path}"
        for one in before or ()
        if one.is_valid and one.name == made.name
    ]
    print(*lines, sep="\n", file=sys.stderr)


def _list(records: tuple[TokenRecord, ...], path: Path) -> None:
    print(f"{'id':<8}  {'role':<8}  {'made':<10}  {'last used':<16}  {'revoked':<10}  name")
    for record in records:
        used = "never" if record.last_used_wall_ns is None else _instant(record.last_used_wall_ns, "%Y-%m-%d %H h")
        revoked = "" if record.revoked_wall_ns is None else _instant(record.revoked_wall_ns, "%Y-%m-%d")
        print(f"{record.id:<8}  {record.role:<8}  {_instant(record.created_wall_ns, '%Y-%m-%d')}  {used:<16}  {revoked:<10}  {record.name}")
    if not records:
        why = "" if path.exists() else ", which is not there; name the service's with --tokens or --store"
        print(f"no tokens in {path.absolute()}{why}", file=sys.stderr)


def _instant(wall_ns: int, form: str) -> str:
    return datetime.fromtimestamp(wall_ns / _NS_PER_S, tz=UTC).strftime(form)
