"""The tokens that are valid now: asked in memory, kept in the file, and read again when somebody else has changed that.

The file is looked at in a thread once a second, and at once where somebody shows a token that is not known yet: one that was made a
moment ago opens what it should. No request of anybody else waits for a disk. Where it cannot be read any more, the tokens that were read
last stay valid, so that nobody is locked out of the emergency stop by a disk; what is wrong is told among the faults of the service.
"""

import asyncio
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import msgspec

from mapper.access.errors import LastAdminError, TokenFileError, TokenNotFoundError
from mapper.access.roles import Person, Role
from mapper.access.token_file import MAX_VALID, Records, change_tokens, read_tokens, write_secret
from mapper.access.tokens import ID_BYTES, SECRET_BYTES, Keyring, TokenRecord, mint, n_admins, token_id
from mapper.errors import TooManyError
from mapper.log import EventLog

_log = EventLog(__name__)

_LOOK_S: Final = 1.0
_LOOK_PATIENCE_S: Final = 0.5
_HOUR_NS: Final = 3_600_000_000_000

_Stamp = tuple[int, int, int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class NewToken:
    """A token that was made; ``text`` is what its holder gets, and is told to nobody again."""

    text: str = field(repr=False)
    record: TokenRecord


def add_token(path: Path, *, name: str, role: Role, secret_file: Path | None = None) -> NewToken:
    """Make a token and keep it in the file, which need not be there.

    Parameters
    ----------
    secret_file
        Write the token there, before it opens anything: none is lost by a kill or a full disk.

    Raises
    ------
    TokenFileError, TokenNameError
        The file cannot be used, or the name.
    TooManyError
        A thousand are valid.
    """

    def add(records: Records) -> tuple[Records, NewToken]:
        if sum(record.is_valid for record in records) >= MAX_VALID:
            raise TooManyError(what="tokens are valid", limit=MAX_VALID)
        taken = {record.id for record in records}
        while True:
            random = secrets.token_bytes(ID_BYTES + SECRET_BYTES)
            text, record = mint(name=name, role=role, random=random, now_wall_ns=time.time_ns())
            if record.id not in taken:
                if secret_file is not None:
                    write_secret(secret_file, text)
                return (*records, record), NewToken(text=text, record=record)

    return change_tokens(path, add)


def revoke_token(path: Path, *, token_id: str, keeps_admin: bool) -> TokenRecord:
    """Revoke a token for ever; one that is revoked stays as it is.

    Raises
    ------
    TokenFileError
        The file cannot be used.
    TokenNotFoundError
        There is none of this id.
    LastAdminError
        ``keeps_admin``, and it is the last that may make others.
    """

    def revoke(records: Records) -> tuple[Records, TokenRecord]:
        record = next((record for record in records if record.id == token_id), None)
        if record is None:
            raise TokenNotFoundError(token_id=token_id)
        if not record.is_valid:
            return records, record
        if keeps_admin and record.role is Role.ADMIN and n_admins(records) == 1:
            raise LastAdminError(token_id=token_id)
        revoked = msgspec.structs.replace(record, revoked_wall_ns=time.time_ns())
        return tuple(revoked if one is record else one for one in records), revoked

    return change_tokens(path, revoke)


class TokenRegister:
    """See the module; made by `open`."""

    def __init__(self, path: Path, *, records: Records, stamp: _Stamp | None, wall_ns: Callable[[], int] = time.time_ns) -> None:
        self._path = path
        self._wall_ns = wall_ns
        self._stamp = stamp
        self._used: dict[str, int] = {}
        self._looking: asyncio.Task[None] | None = None
        self.fault: str | None = None
        """Why the file cannot be read now; None: it can."""
        self._take(records)

    @classmethod
    def open(cls, path: Path) -> "TokenRegister":
        """Read the file; one that is not there has no tokens.

        Raises
        ------
        TokenFileError
            It cannot be used.
        """
        stamp = _stamp(path)
        return cls(path, records=read_tokens(path) or (), stamp=stamp)

    @property
    def records(self) -> Records:
        """All tokens as they are kept, with the hours of their last use as known now."""
        return _with_uses(self._records, self._used)

    def identify(self, text: str) -> Person | None:
        """Say whose a token is; None: nobody's, or it is revoked."""
        record = self._keyring.find(text)
        if record is None:
            return None
        self._used[record.id] = self._wall_ns() // _HOUR_NS * _HOUR_NS
        return Person(name=record.name, role=record.role, token_id=record.id)

    def may_be_new(self, text: str) -> bool:
        """Say whether it has the form of a token, but none that is known has its id: it may have been made a moment ago."""
        name = token_id(text)
        return name is not None and not self._keyring.has(name)

    def is_welcome(self, person: Person) -> bool:
        """Say whether somebody who was admitted would be now: nobody revoked the token."""
        return person.token_id is None or self._keyring.has(person.token_id)

    async def add(self, *, name: str, role: Role) -> NewToken:
        """Make a token; see `add_token`."""
        made = await asyncio.to_thread(add_token, self._path, name=name, role=role)
        await self.look()
        return made

    async def revoke(self, token_id: str) -> TokenRecord:
        """Revoke a token, at once; see `revoke_token`. The last that may make others stays."""
        record = await asyncio.to_thread(revoke_token, self._path, token_id=token_id, keeps_admin=True)
        await self.look()
        return record

    async def run(self) -> None:
        """Look at the file once a second, and note there once an hour who used which token, until cancelled; then note it once more."""
        noted_hour = self._wall_ns() // _HOUR_NS
        try:
            while True:
                await asyncio.sleep(_LOOK_S)
                await self.look()
                if (hour := self._wall_ns() // _HOUR_NS) != noted_hour:
                    noted_hour = hour
                    await asyncio.to_thread(self.note_uses)
        finally:
            self.note_uses()

    async def look_now(self) -> None:
        """Look at the file as it is now, together with all who want that, but wait for a disk that hangs half a second only."""
        if self._looking is None or self._looking.done():
            self._looking = asyncio.create_task(self.look())
        await asyncio.wait({self._looking}, timeout=_LOOK_PATIENCE_S)

    async def look(self) -> None:
        """Read the file again if it is another than was read last."""
        try:
            stamp = await asyncio.to_thread(_stamp, self._path)
            if stamp == self._stamp and self.fault is None:
                return
            records = await asyncio.to_thread(read_tokens, self._path)
        except (TokenFileError, OSError) as error:
            self._tell(str(error))
            return
        if records is None and self._records:
            self._tell(f"tokens {self._path}: is gone; restore it; until then all tokens stay as they were")
            return
        self._tell(None)
        if stamp != self._stamp:
            self._stamp = stamp
            self._take(records or ())
            _log.info("access.tokens_read", valid=sum(record.is_valid for record in self._records))

    def note_uses(self) -> None:
        """Keep the hours of last uses in the file; where that cannot be, they are kept in memory."""
        used = dict(self._used)
        if _with_uses(self._records, used) == self._records:
            return
        try:
            change_tokens(self._path, lambda records: (_with_uses(records, used), None))
        except TokenFileError as error:
            _log.warning("access.uses_not_noted", reason=str(error))

    def _take(self, records: Records) -> None:
        self._records = records
        self._keyring = Keyring(records)
        known = {record.id for record in records}
        self._used = {name: hour for name, hour in self._used.items() if name in known}

    def _tell(self, fault: str | None) -> None:
        if fault != self.fault:
            if fault is not None:
                _log.error("access.tokens_unusable", reason=fault)
            else:
                _log.info("access.tokens_usable")
        self.fault = fault


def _with_uses(records: Records, used: dict[str, int]) -> Records:
    return tuple(
        msgspec.structs.replace(record, last_used_wall_ns=hour)
        if (hour := used.get(record.id, 0)) > (record.last_used_wall_ns or 0)
        else record
        for record in records
    )


def _stamp(path: Path) -> _Stamp | None:
    """Return what tells one version of the file from another; None: it is not there."""
    try:
        facts = path.stat()
    except FileNotFoundError:
        return None
    return facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns, facts.st_mode
