"""Liveliness tokens: who is there (CONTRACT.md §2).

``alive/{gateway}``, ``radios/{gateway}/{radio}`` while the radio is up, ``mappers/{name}``, ``commanders/{name}``. A radio is named
for its port, which may hold what a key must not: everything but ``A-Z a-z 0-9 _ . - ~`` is percent-encoded (RFC 3986 §2.1).
"""

from dataclasses import dataclass
from enum import Enum
from urllib.parse import quote, unquote

from firmware_protocol.contract.keys import ANY, ROOT, check_name
from firmware_protocol.errors import KeyExpressionError

_MAX_RADIO = 255


class Kind(Enum):
    """What is alive."""

    GATEWAY = "alive"
    RADIO = "radios"
    MAPPER = "mappers"
    COMMANDER = "commanders"


@dataclass(frozen=True, slots=True, kw_only=True)
class Token:
    """A liveliness token. ``name`` is the gateway's for a radio; ``radio`` is None for all else."""

    site: str
    kind: Kind
    name: str
    radio: str | None = None


def build_token_key(*, site: str, kind: Kind, name: str, radio: str | None = None) -> str:
    """Return the key of a token; ``ANY`` stands for any name or radio.

    Raises
    ------
    KeyExpressionError
        A name cannot stand in a key, a radio is missing, or one is given that does not belong there.
    """
    for part, what in ((site, "site"), (name, kind.name.lower())):
        if part != ANY:
            check_name(part, what=what)
    key = f"{ROOT}/{site}/{kind.value}/{name}"
    if (radio is not None) != (kind is Kind.RADIO):
        raise KeyExpressionError(key=key, reason="a token of a radio names it, and no other token does")
    if radio is None:
        return key
    if not 1 <= len(radio) <= _MAX_RADIO:
        raise KeyExpressionError(key=key, reason=f"a radio's name has 1 to {_MAX_RADIO} characters, not {len(radio)}")
    return f"{key}/{radio if radio == ANY else quote(radio, safe='')}"


def parse_token_key(key: str) -> Token:
    """Return whose token a concrete key is.

    Raises
    ------
    KeyExpressionError
        It is no token of this version.
    """
    root, _, rest = key.partition(ROOT + "/")
    parts = rest.split("/")
    kinds = {kind.value: kind for kind in Kind}
    if root or len(parts) not in {3, 4} or parts[1] not in kinds:
        raise KeyExpressionError(key=key, reason=f"not of the form {ROOT}/SITE/alive|radios|mappers|commanders/NAME[/RADIO]")
    kind = kinds[parts[1]]
    if (len(parts) == 4) != (kind is Kind.RADIO):
        raise KeyExpressionError(key=key, reason="a token of a radio names it, and no other token does")
    site, name = check_name(parts[0], what="site"), check_name(parts[2], what=kind.name.lower())
    if kind is not Kind.RADIO:
        return Token(site=site, kind=kind, name=name)
    try:
        radio = unquote(parts[3], errors="strict")
    except UnicodeDecodeError as error:
        raise KeyExpressionError(key=key, reason="the radio's name is no percent-encoded UTF-8") from error
    if not 1 <= len(radio) <= _MAX_RADIO or "*" in parts[3] or "$" in parts[3]:
        raise KeyExpressionError(key=key, reason=f"a radio's name has 1 to {_MAX_RADIO} characters and no wildcard")
    return Token(site=site, kind=kind, name=name, radio=radio)
