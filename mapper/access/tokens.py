"""Tokens: 256 random bits that a person holds, of which the service keeps a hash. Pure: randomness and time are arguments.

A secret of 256 random bits cannot be guessed from its SHA-256, so no slow password hash is needed, and a stop does not wait for one
(docs/adr/0037-who-may-command.md).
"""

import hashlib
import hmac
import re
from collections.abc import Iterable, Sequence
from typing import Annotated, Final

import msgspec

from mapper.access.errors import TokenNameError
from mapper.access.roles import Role

ID_BYTES: Final = 4
SECRET_BYTES: Final = 32
MAX_NAME: Final = 64
"""Characters, as the contract on the bus has it for the name of an operator (CONTRACT.md §4)."""

_FORM: Final = re.compile(r"biobot_([0-9a-f]{8})_([0-9a-f]{64})", re.ASCII)
_ANYWHERE: Final = re.compile(r"biobot_[0-9a-f]{8}_[0-9a-f]+", re.ASCII | re.IGNORECASE)
_TAKEN_NAMES: Final = frozenset({"anonymous", "dead-man", "mapper-shutdown", "mission", "unnamed"})
"""Those under which the services themselves command, or did: nobody is to be mistaken for one."""
_NOBODY: Final = hashlib.sha256(b"").digest()


class TokenRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is kept of a token; instants in nanoseconds of the wall clock."""

    id: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{8}$")]
    name: Annotated[str, msgspec.Meta(min_length=1, max_length=MAX_NAME)]
    role: Role
    hash: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$")]
    created_wall_ns: int
    last_used_wall_ns: int | None = None
    """To the hour; None: never."""
    revoked_wall_ns: int | None = None

    @property
    def is_valid(self) -> bool:
        """Whether it opens anything still."""
        return self.revoked_wall_ns is None


def check_name(name: str) -> str:
    """Return the name as it is kept: without blanks around it.

    Raises
    ------
    TokenNameError
        It cannot stand in an audit log, or a service bears it.
    """
    bare = name.strip()
    if not 1 <= len(bare) <= MAX_NAME or not bare.isprintable():
        raise TokenNameError(name=name, problem=f"wanted 1 to {MAX_NAME} printable characters")
    if bare.casefold() in _TAKEN_NAMES:
        raise TokenNameError(name=name, problem="the services themselves command under it; take the person's own")
    return bare


def mint(*, name: str, role: Role, random: bytes, now_wall_ns: int) -> tuple[str, TokenRecord]:
    """Make a token of 36 random bytes; return what its holder gets, once, and what is kept.

    Raises
    ------
    TokenNameError
        As `check_name`.
    """
    if len(random) != ID_BYTES + SECRET_BYTES:
        raise ValueError(f"{len(random)} random bytes, but a token is made of {ID_BYTES + SECRET_BYTES}")
    token = f"biobot_{random[:ID_BYTES].hex()}_{random[ID_BYTES:].hex()}"
    record = TokenRecord(
        id=random[:ID_BYTES].hex(), name=check_name(name), role=role, hash=_digest(token).hex(), created_wall_ns=now_wall_ns
    )
    return token, record


def token_id(text: str) -> str | None:
    """Return the id in what should be a token, which is no secret; None: it has not the form of one."""
    match = _FORM.fullmatch(text)
    return None if match is None else match[1]


def contains_token(text: str) -> bool:
    """Say whether something in a text has the form of a token, or of the begin of one."""
    return _ANYWHERE.search(text) is not None


class Keyring:
    """Finds whose a token is, among those that are valid; takes the same time whether or not there is one of its id."""

    def __init__(self, records: Iterable[TokenRecord]) -> None:
        self._records = {record.id: (bytes.fromhex(record.hash), record) for record in records if record.is_valid}

    def has(self, name: str) -> bool:
        """Say whether there is a valid token of an id."""
        return name in self._records

    def find(self, text: str) -> TokenRecord | None:
        """Return the record of a token; None: it is none of ours, or revoked."""
        name = token_id(text)
        if name is None:
            return None
        kept, record = self._records.get(name, (_NOBODY, None))
        return record if hmac.compare_digest(kept, _digest(text)) else None


def n_admins(records: Sequence[TokenRecord]) -> int:
    """Count the valid tokens that may make others."""
    return sum(record.is_valid and record.role is Role.ADMIN for record in records)


def _digest(token: str) -> bytes:
    return hashlib.sha256(token.encode()).digest()
