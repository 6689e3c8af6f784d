"""Errors of access: each leaf is named for what the caller can do about it.

MapError
├── NoTokenError        a request shows no token, or one that opens nothing
├── RoleError           a token's role does not reach so far
├── RateLimitError      somebody asks too often
├── TokenFileError      the file of tokens cannot be used
├── TokenNameError      a token cannot be made for this name
├── TokenNotFoundError  there is no token of this id
└── LastAdminError      the last token that may make others is not revoked
"""

from mapper.errors import MapError


class NoTokenError(MapError):
    """A request shows no token where one is needed, or (``is_wrong``) one that opens nothing."""

    def __init__(self, *, is_wrong: bool, needed: str) -> None:
        how = "send the header `Authorization: Bearer biobot_...`; an admin makes tokens: biobot-mapper tokens add NAME --role ROLE"
        what = "this token is none of this service, or was revoked" if is_wrong else f"this needs the token of a person who is {needed}"
        super().__init__(f"{what}; {how}")
        self.is_wrong = is_wrong
        self.needed = needed


class RoleError(MapError):
    """The role of a token does not reach so far."""

    def __init__(self, *, name: str, role: str, needed: str) -> None:
        super().__init__(f"{name} is {role}, but this needs the role {needed}; an admin makes such a token")
        self.role = role
        self.needed = needed


class RateLimitError(MapError):
    """Somebody asks too often; ``wait_s`` [s] until there is room for one more."""

    def __init__(self, *, what: str, rate: float, burst: float, wait_s: float) -> None:
        super().__init__(f"too many {what}: {burst:g} at once and then {rate:g} a second are taken; wait {wait_s:.1f} s")
        self.wait_s = wait_s


class TokenFileError(MapError):
    """The file of tokens cannot be used; it was not changed."""

    def __init__(self, *, path: str, reason: str, next_step: str) -> None:
        super().__init__(f"tokens {path}: {reason}; {next_step}")
        self.path = path
        self.reason = reason


class TokenNameError(MapError):
    """A token cannot be made for this name."""

    def __init__(self, *, name: str, problem: str) -> None:
        super().__init__(f"no token is made for the name {name[:80]!r}: {problem}")
        self.name = name


class TokenNotFoundError(MapError):
    """There is no token of this id."""

    def __init__(self, *, token_id: str) -> None:
        super().__init__(f"no token has the id {token_id[:80]!r}; biobot-mapper tokens list names all")
        self.token_id = token_id


class LastAdminError(MapError):
    """The last token that may make others is not revoked over the network: nobody could make one again."""

    def __init__(self, *, token_id: str) -> None:
        super().__init__(f"token {token_id} is the last of an admin; make another first, or revoke it with biobot-mapper tokens revoke")
        self.token_id = token_id
