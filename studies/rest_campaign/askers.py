"""Who asks: nobody in particular, the holders of tokens of each role, and those whose tokens open nothing."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from mapper.access import Role


class Asker(StrEnum):
    """Who sends a request."""

    ANONYMOUS = "anonymous"
    VIEWER = "viewer"
    OPERATOR = "operator"
    ADMIN = "admin"
    STRANGER = "stranger"
    """Shows a token that opens nothing."""

    @property
    def role(self) -> Role | None:
        """The role of the token that is shown; None: none, or one that opens nothing."""
        return _ROLES.get(self)


_ROLES: Final = {Asker.VIEWER: Role.VIEWER, Asker.OPERATOR: Role.OPERATOR, Asker.ADMIN: Role.ADMIN}

STRANGE_TOKENS: Final = (
    "",
    "Bearer",
    "Bearer ",
    "Basic YWRtaW46YWRtaW4=",
    "Bearer biobot_00000000_" + "A" * 43,
    "bearer biobot_",
    "Bearer biobot_00000000_" + "é" * 43,
    "Bearer " + "A" * 6000,
    "Bearer biobot_00000000_AAAA, Bearer biobot_11111111_BBBB",
    "\t",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A mapper that serves, and a token of each role."""

    url: str
    """Without a slash at its end."""
    tokens: Mapping[Role, str]

    def shown_by(self, asker: Asker) -> str | None:
        """Return the header ``Authorization`` of an asker who has one to show."""
        return None if asker.role is None else f"Bearer {self.tokens[asker.role]}"


def is_let_in(asker: Asker, *, needed: Role | None) -> bool:
    """Say whether an asker may do what needs a role (None: nothing), where whoever is on this machine may read."""
    if needed is None:
        return True
    if asker is Asker.ANONYMOUS:
        return needed is Role.VIEWER
    return asker.role is not None and asker.role.covers(needed)
