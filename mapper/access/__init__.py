"""Who may see and command: tokens, roles, limits."""

from mapper.access.access import Access, person_of
from mapper.access.buckets import Rate
from mapper.access.errors import (
    LastAdminError,
    NoTokenError,
    RateLimitError,
    RoleError,
    TokenFileError,
    TokenNameError,
    TokenNotFoundError,
)
from mapper.access.first_token import open_register
from mapper.access.limits import RateLimits
from mapper.access.register import NewToken, TokenRegister, add_token, revoke_token
from mapper.access.roles import ANONYMOUS, TOKENS_PATH, Person, Role, role_needed
from mapper.access.token_file import read_tokens
from mapper.access.tokens import MAX_NAME, TokenRecord, check_name, contains_token

__all__ = [
    "ANONYMOUS",
    "MAX_NAME",
    "TOKENS_PATH",
    "Access",
    "LastAdminError",
    "NewToken",
    "NoTokenError",
    "Person",
    "Rate",
    "RateLimitError",
    "RateLimits",
    "Role",
    "RoleError",
    "TokenFileError",
    "TokenNameError",
    "TokenNotFoundError",
    "TokenRecord",
    "TokenRegister",
    "add_token",
    "check_name",
    "contains_token",
    "open_register",
    "person_of",
    "read_tokens",
    "revoke_token",
    "role_needed",
]
