"""What the OpenAPI document says of access: the same rule that the door holds to, put into every operation."""

from http import HTTPStatus
from typing import Any, Final

from mapper.access import Role, role_needed
from mapper.api.descriptions import describe_problem

SCHEME: Final = "token"

_SCHEME: Final = {
    "type": "http",
    "scheme": "bearer",
    "bearerFormat": "biobot_<id>_<secret>",
    "description": "A person's token. Roles: viewer looks, operator commands, admin makes tokens; each may do what those before it may.",
}
_WHO: Final = {Role.VIEWER: "Whoever has a token", Role.OPERATOR: "Operators and admins", Role.ADMIN: "Admins"}


def describe_access(document: dict[str, Any], *, allows_anonymous_reading: bool) -> None:
    """Add to each operation whom it is for, and how it answers all others."""
    document.setdefault("components", {}).setdefault("securitySchemes", {})[SCHEME] = _SCHEME
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            needed = role_needed(method.upper(), path)
            answers = operation["responses"]
            _add(answers, HTTPStatus.BAD_REQUEST)
            _add(answers, HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
            if needed is None:
                operation["security"] = []
                continue
            is_free = needed is Role.VIEWER and allows_anonymous_reading
            operation["security"] = [{SCHEME: []}, *([{}] if is_free else [])]
            who = f"{_WHO[needed]}{', and without one whoever is on this machine' if is_free else ''}."
            operation["description"] = f"{operation.get('description', '')}\n\nFor: {who}".strip()
            operation["x-role"] = str(needed)
            _add(answers, HTTPStatus.UNAUTHORIZED)
            _add(answers, HTTPStatus.TOO_MANY_REQUESTS)
            if needed is not Role.VIEWER:
                _add(answers, HTTPStatus.FORBIDDEN)


def _add(answers: dict[str, Any], status: HTTPStatus) -> None:
    answers.setdefault(str(status.value), describe_problem(status))
