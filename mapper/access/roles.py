"""Who may do what: three roles, and one rule that gives every request the role it needs."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

TOKENS_PATH: Final = "/api/v1/tokens"

_SAFE_METHODS: Final = frozenset({"GET", "HEAD", "OPTIONS"})
_OPEN_PATHS: Final = frozenset({"/", "/healthz", "/readyz", "/metrics", "/openapi.json"})
_OPEN_FOLDER: Final = "/static/"


class Role(StrEnum):
    """What a person may do; each may do what those before it may."""

    VIEWER = "viewer"
    """Look."""
    OPERATOR = "operator"
    """Command biobots and missions, and change what is kept."""
    ADMIN = "admin"
    """Make and revoke tokens."""

    def covers(self, needed: "Role") -> bool:
        """Say whether this role may do what needs another."""
        return _RANKS[self] >= _RANKS[needed]


_RANKS: Final = {role: rank for rank, role in enumerate(Role)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Person:
    """Who asks: the holder of a token, or (``token_id`` None) anybody on this machine, who may look."""

    name: str
    role: Role
    token_id: str | None

    @property
    def is_anonymous(self) -> bool:
        """Whether no token was shown."""
        return self.token_id is None


ANONYMOUS: Final = Person(name="anonymous", role=Role.VIEWER, token_id=None)


def role_needed(method: str, path: str) -> Role | None:
    """Return the role that a request needs; None: it is open to all.

    The page itself and what watches the process are open to all who read. All else is closed: a route that is added later needs an
    operator where it writes and a viewer where it reads, whether or not anybody thought of it.
    """
    is_safe = method in _SAFE_METHODS
    if path == TOKENS_PATH or path.startswith(f"{TOKENS_PATH}/"):
        return Role.ADMIN
    if is_safe and (path in _OPEN_PATHS or path.startswith(_OPEN_FOLDER)):
        return None
    return Role.VIEWER if is_safe else Role.OPERATOR
