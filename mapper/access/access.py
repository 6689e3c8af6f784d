"""Whether a request is admitted: by what it shows, what it wants, and how often. Pure but for the register and the clock of the limits."""

from collections import Counter
from collections.abc import MutableMapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from mapper.access.errors import NoTokenError, RateLimitError, RoleError
from mapper.access.limits import RateLimits
from mapper.access.register import TokenRegister
from mapper.access.roles import ANONYMOUS, Person, Role, role_needed
from mapper.access.tokens import token_id
from mapper.log import EventLog

_log = EventLog(__name__)

PERSON_KEY: Final = "biobot.person"
"""Where a request's scope has who asks."""

_STOP_PATH: Final = "/api/v1/stop"
_COMMANDS_PATH: Final = "/api/v1/commands"
_COUNTED_LATER: Final = frozenset({_STOP_PATH, _COMMANDS_PATH})
"""A stop is never too many; which commands are stops, only their bodies tell."""

_SCHEME: Final = "bearer"


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """What decides. ``allows_anonymous_reading``: whoever reaches the service may look."""

    register: TokenRegister
    limits: RateLimits
    allows_anonymous_reading: bool
    refused: Counter[str] = field(default_factory=Counter)
    """How many were refused, by reason."""

    def admit(self, *, method: str, path: str, authorization: str | None, address: str) -> Person | None:
        """Return who asks; None: it is open to all.

        Parameters
        ----------
        authorization
            The request's header of that name; None: there is none.
        address
            Where it comes from; empty: from this machine.

        Raises
        ------
        NoTokenError, RoleError, RateLimitError
            It is not admitted.
        """
        needed = role_needed(method, path)
        if needed is None:
            return None
        try:
            person = self._identify(authorization, needed=needed, address=address, is_stop=path == _STOP_PATH)
            _expect_role(person, needed)
            if needed is Role.VIEWER and not _is_local(address):
                self.limits.take_read(person, address=address)
            elif needed is not Role.VIEWER and path not in _COUNTED_LATER:
                self.limits.take_write(person)
        except (NoTokenError, RoleError, RateLimitError) as error:
            self.refused[f"refused_{_REASONS[type(error)]}"] += 1
            raise
        return person

    async def learn(self, authorization: str | None) -> None:
        """Have `admit` know a token that somebody made a moment ago with the command line."""
        if authorization is not None and self.register.may_be_new(_text_of(authorization)):
            await self.register.look_now()

    def _identify(self, authorization: str | None, *, needed: Role, address: str, is_stop: bool) -> Person:
        if authorization is None:
            if needed is Role.VIEWER and self.allows_anonymous_reading:
                return ANONYMOUS
            raise NoTokenError(is_wrong=False, needed=needed)
        text = _text_of(authorization)
        person = self.register.identify(text)
        if person is not None:
            return person
        # Whose token is sound is never held up by others who try some, and no stop is answered with "too many".
        if not is_stop and self.limits.take_wrong_token(address=address):
            _log.warning("access.wrong_token", address=address, token=token_id(text) or "malformed")
        raise NoTokenError(is_wrong=True, needed=needed)


_REASONS: Final = {NoTokenError: "no_token", RoleError: "role", RateLimitError: "rate"}


class _Request(Protocol):
    @property
    def scope(self) -> MutableMapping[str, Any]: ...


def person_of(request: _Request) -> Person:
    """Return who makes a request; on open routes nobody knows, and this raises ``KeyError``."""
    person: Person = request.scope[PERSON_KEY]
    return person


def _text_of(authorization: str) -> str:
    """Return what is shown by our scheme; empty: nothing is."""
    scheme, _, text = authorization.strip().partition(" ")
    return text.strip() if scheme.lower() == _SCHEME else ""


def _expect_role(person: Person, needed: Role) -> None:
    if not person.role.covers(needed):
        raise RoleError(name=person.name, role=person.role, needed=needed)


def _is_local(address: str) -> bool:
    return not address or address.startswith(("127.", "::ffff:127.")) or address == "::1"
