"""The little of CSS that says whether an SVG shape is painted: plain selectors and a handful of properties."""

import re

_PROPERTIES = frozenset({"fill", "fill-rule", "display", "visibility"})
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_RULE = re.compile(r"([^{}]*)\{([^{}]*)\}")


class Stylesheet:
    """The rules of a drawing's ``<style>`` elements whose selector is one class, id or element name; other rules are ignored."""

    __slots__ = ("_rules",)

    def __init__(self) -> None:
        self._rules: dict[str, dict[str, str]] = {}

    def add(self, text: str) -> None:
        """Take in the text of a style element; a later rule of one selector wins."""
        for selectors, declarations in _RULE.findall(_COMMENT.sub(" ", text)):
            for selector in selectors.split(","):
                self._rules.setdefault(selector.strip(), {}).update(read_declarations(declarations))

    def find(self, *, tag: str, classes: list[str], identity: str | None) -> dict[str, str]:
        """Return the properties of an element: by name first, then by its classes as written, then by its id, which win in that order."""
        found: dict[str, str] = {}
        for selector in ("*", tag, *(f".{one}" for one in classes), f"#{identity}"):
            found |= self._rules.get(selector, {})
        return found


def read_declarations(text: str) -> dict[str, str]:
    """Read ``name: value; ...``, keeping what matters here, in small letters."""
    found = {}
    for declaration in _COMMENT.sub(" ", text).split(";"):
        name, _, value = declaration.partition(":")
        if name.strip().lower() in _PROPERTIES:
            found[name.strip().lower()] = value.replace("!important", "").strip().lower()
    return found
