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
    made = add_token(path, name=args.subject, role=Role(args.role), secret_file=args.token_file)
    if args.token_file is None:
        print(made.text)
    print(f"{made.record.role} {made.record.name}, id {made.record.id}, in {path}; the token is shown this once", file=sys.stderr)
    return 0


def _list(records: tuple[TokenRecord, ...], path: Path) -> None:
    print(f"{'id':<8}  {'role':<8}  {'made':<10}  {'last used':<16}  {'revoked':<10}  name")
    for record in records:
        used = "never" if record.last_used_wall_ns is None else _instant(record.last_used_wall_ns, "%Y-%m-%d %H h")
        revoked = "" if record.revoked_wall_ns is None else _instant(record.revoked_wall_ns, "%Y-%m-%d")
        print(f"{record.id:<8}  {record.role:<8}  {_instant(record.created_wall_ns, '%Y-%m-%d')}  {used:<16}  {revoked:<10}  {record.name}")
    if not records:
        print(f"no tokens in {path}", file=sys.stderr)


def _instant(wall_ns: int, form: str) -> str:
    return datetime.fromtimestamp(wall_ns / _NS_PER_S, tz=UTC).strftime(form)
