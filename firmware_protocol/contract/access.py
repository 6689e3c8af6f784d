"""Who may do what on Zenoh, by the common name of a certificate: one table, and Zenoh's access control made from it.

A common name is ``{site}/{role}/{name}``, such as ``demo/gateway/base1``; the site ``*`` stands for all sites. What no row of the
table allows is denied. A router knows the certificates it heeds from a roster, one common name a line: whom it does not list
may connect, and is denied everything.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final

from firmware_protocol.contract.keys import ANY, ROOT, check_name
from firmware_protocol.errors import KeyExpressionError

MAX_COMMON_NAME: Final = 64
"""Characters of a common name (X.520, ub-common-name)."""


class Role(Enum):
    """What a certificate is for."""

    GATEWAY = "gateway"
    MAPPER = "mapper"
    OPERATOR = "operator"
    VIEWER = "viewer"
    ROUTER = "router"


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Whom a certificate names. ``site`` is ``ANY`` for one that is welcome at all sites."""

    site: str
    role: Role
    name: str

    @property
    def common_name(self) -> str:
        """The form that it has in a certificate and a roster."""
        return f"{self.site}/{self.role.value}/{self.name}"


def parse_identity(common_name: str) -> Identity:
    """Return whom a common name names.

    Raises
    ------
    KeyExpressionError
        It is not ``{site}/{role}/{name}``, or too long for a certificate.
    """
    parts = common_name.split("/")
    roles = ", ".join(role.value for role in Role)
    if len(parts) != 3:
        raise KeyExpressionError(key=common_name, reason="a common name is SITE/ROLE/NAME, such as demo/gateway/base1")
    if len(common_name) > MAX_COMMON_NAME:
        raise KeyExpressionError(
            key=common_name, reason=f"it has {len(common_name)} characters, but a certificate's name has at most {MAX_COMMON_NAME}"
        )
    site, role, name = parts
    if site != ANY:
        check_name(site, what="site")
    if role not in {one.value for one in Role}:
        raise KeyExpressionError(key=common_name, reason=f"there is no role {role!r}; roles: {roles}")
    return Identity(site=site, role=Role(role), name=check_name(name, what=role))


def parse_roster(text: str) -> tuple[list[Identity], list[str]]:
    """Return the identities in a roster, and what is wrong with it, one line each. ``#`` begins a comment."""
    members: dict[str, Identity] = {}
    problems = []
    for number, line in enumerate(text.splitlines(), start=1):
        entry = line.partition("#")[0].strip()
        if not entry:
            continue
        try:
            members[entry] = parse_identity(entry)
        except KeyExpressionError as error:
            problems.append(f"line {number}: {error}")
    return list(members.values()), problems


def identity_problem(common_name: str, *, roles: tuple[Role, ...], site: str | None, name: str | None) -> str | None:
    """Return why a router would not let the holder of a certificate do what it is about to do, or None."""
    try:
        identity = parse_identity(common_name)
    except KeyExpressionError as error:
        return f"its common name is none of ours: {error}; have it issued by `biobot-gateway certs issue`"
    wanted = " or ".join(role.value for role in roles)
    if identity.role not in roles:
        return f"its role is {identity.role.value} ({common_name}), but {wanted} is needed here; routers would refuse it"
    if not _fits(identity, site=site, name=name):
        return f"it is for {common_name}, but this is {identity.role.value} {name or identity.name!r} of site {site!r}; issue one for it"
    return None


class Deed(Enum):
    """What may be done with the keys of a stream."""

    PUBLISH = "publish"
    SUBSCRIBE = "subscribe"
    ANSWER = "answer"
    ASK = "ask"
    BE_ALIVE = "be alive"
    WATCH = "watch"


class Scope(Enum):
    """Whose keys of a stream."""

    OWN = "own"
    """``{stream}/{name}``."""
    OWN_LAST = "own, last"
    """``{stream}/{anybody}/{name}``: what a mapper tells a gateway."""
    SITE = "site"


@dataclass(frozen=True, slots=True)
class Permission:
    """A row of the table: ``role`` may do ``deed`` on the keys of ``streams``."""

    role: Role
    deed: Deed
    scope: Scope
    streams: tuple[str, ...]


_HEARD: Final = ("encounters", "modes", "mission", "status", "neighbours", "events", "stages", "stimulation")
_SEEN: Final = ("alive", "radios", "mappers", "commanders")

PERMISSIONS: Final = (
    Permission(Role.GATEWAY, Deed.PUBLISH, Scope.OWN, (*_HEARD, "echo")),
    Permission(Role.GATEWAY, Deed.ANSWER, Scope.OWN, ("command", "history", "orders", "recordings", "echo")),
    Permission(Role.GATEWAY, Deed.ASK, Scope.OWN, ("echo",)),
    Permission(Role.GATEWAY, Deed.BE_ALIVE, Scope.OWN, ("alive", "radios")),
    Permission(Role.GATEWAY, Deed.SUBSCRIBE, Scope.OWN, ("watermark", "echo")),
    Permission(Role.GATEWAY, Deed.SUBSCRIBE, Scope.SITE, ("beat",)),
    Permission(Role.GATEWAY, Deed.WATCH, Scope.OWN, ("alive",)),
    Permission(Role.GATEWAY, Deed.WATCH, Scope.SITE, ("commanders",)),
    Permission(Role.MAPPER, Deed.SUBSCRIBE, Scope.SITE, _HEARD),
    Permission(Role.MAPPER, Deed.ASK, Scope.SITE, ("command", "history", "orders", "recordings")),
    Permission(Role.MAPPER, Deed.PUBLISH, Scope.OWN, ("beat", "echo")),
    Permission(Role.MAPPER, Deed.ANSWER, Scope.OWN, ("echo",)),
    Permission(Role.MAPPER, Deed.ASK, Scope.OWN, ("echo",)),
    Permission(Role.MAPPER, Deed.SUBSCRIBE, Scope.OWN, ("echo",)),
    Permission(Role.MAPPER, Deed.PUBLISH, Scope.OWN_LAST, ("watermark",)),
    Permission(Role.MAPPER, Deed.BE_ALIVE, Scope.OWN, ("mappers", "commanders")),
    Permission(Role.MAPPER, Deed.WATCH, Scope.SITE, _SEEN),
    Permission(Role.OPERATOR, Deed.SUBSCRIBE, Scope.SITE, (*_HEARD, "watermark")),
    Permission(Role.OPERATOR, Deed.ASK, Scope.SITE, ("command", "orders")),
    Permission(Role.OPERATOR, Deed.PUBLISH, Scope.OWN, ("beat",)),
    Permission(Role.OPERATOR, Deed.BE_ALIVE, Scope.OWN, ("commanders",)),
    Permission(Role.OPERATOR, Deed.WATCH, Scope.SITE, _SEEN),
    Permission(Role.VIEWER, Deed.SUBSCRIBE, Scope.SITE, (*_HEARD, "watermark")),
    Permission(Role.VIEWER, Deed.WATCH, Scope.SITE, _SEEN),
)
"""All that is allowed. A router may pass everything on: it is as trusted as the one that it is connected to."""


def may(identity: Identity, deed: Deed, *, stream: str, site: str, name: str | None = None) -> bool:
    """Say whether the table lets somebody do something; ``name`` is whose key it is, None for a whole site's."""
    if identity.site not in {ANY, site}:
        return False
    if identity.role is Role.ROUTER:
        return True
    return any(
        row.role is identity.role
        and row.deed is deed
        and stream in row.streams
        and (row.scope is Scope.SITE or (name is not None and name == identity.name))
        for row in PERMISSIONS
    )


# What a deed is in Zenoh's words, seen from the router: what comes in from whoever does it, and what goes out to it. A declaration of
# the other side (its subscription to all gateways, say) is wider than one's own keys, hence the third column: it is heard for the stream.
_WORDS: Final[dict[Deed, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]]] = {
    Deed.PUBLISH: (
        ("put", "delete", "reply", "declare_queryable", "liveliness_token"),
        (),
        ("declare_subscriber", "query", "liveliness_query", "declare_liveliness_subscriber"),
    ),
    Deed.SUBSCRIBE: (
        ("declare_subscriber", "query", "liveliness_query", "declare_liveliness_subscriber"),
        ("put", "delete", "reply", "declare_queryable", "liveliness_token"),
        (),
    ),
    Deed.ANSWER: (("declare_queryable", "reply"), (), ("query",)),
    Deed.ASK: (("query",), ("reply", "declare_queryable"), ()),
    Deed.BE_ALIVE: (("liveliness_token",), (), ("liveliness_query", "declare_liveliness_subscriber")),
    Deed.WATCH: (("liveliness_query", "declare_liveliness_subscriber"), ("liveliness_token",), ()),
}
_ALL_MESSAGES: Final = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)


def access_control(members: Sequence[Identity]) -> dict[str, object]:
    """Return Zenoh's ``access_control`` for a router that heeds these and nobody else."""
    rules: list[dict[str, object]] = []
    subjects: list[dict[str, object]] = []
    policies: list[dict[str, object]] = []
    for member in members:
        made = _router_rules(member) if member.role is Role.ROUTER else _member_rules(member)
        rules += made
        subjects.append({"id": member.common_name, "cert_common_names": [member.common_name]})
        policies.append({"rules": [rule["id"] for rule in made], "subjects": [member.common_name]})
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}


def _member_rules(member: Identity) -> list[dict[str, object]]:
    rules: list[dict[str, object]] = []
    for row in PERMISSIONS:
        if row.role is not member.role:
            continue
        incoming, outgoing, heard = _WORDS[row.deed]
        own = _patterns(member, row.streams, scope=row.scope)
        whole = _patterns(member, row.streams, scope=Scope.SITE)
        label = f"{member.common_name}: {row.deed.value} {row.scope.value} {'+'.join(row.streams)}"
        for flow, messages, keys in (("ingress", incoming, own), ("egress", outgoing, own), ("egress", heard, whole)):
            if messages:
                rules.append(_rule(f"{label} {flow} {len(rules)}", flow=flow, messages=messages, keys=keys))
    return rules


def _router_rules(member: Identity) -> list[dict[str, object]]:
    keys = [f"{ROOT}/{member.site}/**", f"{ROOT}/{member.site}/**/@adv/**"]
    return [_rule(f"{member.common_name}: {flow}", flow=flow, messages=_ALL_MESSAGES, keys=keys) for flow in ("ingress", "egress")]


def _rule(label: str, *, flow: str, messages: Sequence[str], keys: Sequence[str]) -> dict[str, object]:
    return {"id": label, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": list(keys)}


def _patterns(member: Identity, streams: Sequence[str], *, scope: Scope) -> list[str]:
    """Return the keys of streams; no wildcard crosses the ``@adv`` under which a publisher's cache and heartbeat are."""
    rest = {Scope.OWN: f"/{member.name}", Scope.OWN_LAST: f"/{ANY}/{member.name}", Scope.SITE: ""}[scope]
    bases = [f"{ROOT}/{member.site}/{stream}{rest}" for stream in streams]
    return [key for base in bases for key in (f"{base}/**", f"{base}/**/@adv/**")]


def _fits(identity: Identity, *, site: str | None, name: str | None) -> bool:
    return (site is None or identity.site in {ANY, site}) and (name is None or identity.name == name)
