"""What program computed a result: a fingerprint of the code that it runs through, so that an older program's results are known.

Counted is the module of the computing function with all of our modules that it imports, directly or not, and the C files beside them.
Comments, docstrings and layout do not count. Neither does this package, which only hands cases round, nor libraries: their versions are
pinned by the lock files.
"""

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

OURS = ("firmware_protocol", "gateway", "mapper", "simulator", "studies")

_NOT_COUNTED = "studies.cases"
_FINGERPRINT_LENGTH = 16
_Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True, slots=True, kw_only=True)
class PackageFile:
    """A file in one of our packages, such as trained parameters."""

    package: str
    path: str

    def read(self) -> bytes:
        """Return its content."""
        return resources.files(self.package).joinpath(self.path).read_bytes()


def fingerprint(compute: Callable[..., Any], files: Sequence[PackageFile] = ()) -> str:
    """Name the program that computes a case."""
    parts = hashlib.sha256()
    for name, content in _sources(compute.__module__):
        parts.update(f"{name}\0{len(content)}\0".encode() + content)
    for file in files:
        content = file.read()
        parts.update(f"{file.package}/{file.path}\0{len(content)}\0".encode() + content)
    return parts.hexdigest()[:_FINGERPRINT_LENGTH]


def modules_behind(name: str) -> dict[str, Path]:
    """Return a module and all of our modules that it imports, directly or not, by name, with their files."""
    found: dict[str, Path] = {}
    open_names = [name]
    while open_names:
        one = open_names.pop()
        is_new = one not in found and one != _NOT_COUNTED and not one.startswith(f"{_NOT_COUNTED}.")
        path = _file_of(one) if is_new else None
        if path is None:
            continue
        found[one] = path
        # A package's __init__ runs before any module in it.
        open_names += [".".join(one.split(".")[:depth]) for depth in range(1, one.count(".") + 1)]
        open_names += _imported(path.read_bytes())
    return found


def _sources(name: str) -> list[tuple[str, bytes]]:
    modules = modules_behind(name)
    python = {one: reduce_source(path.read_bytes()) for one, path in modules.items()}
    beside = {file for path in modules.values() if path.name == "__init__.py" for file in path.parent.glob("*.[ch]")}
    compiled = {f"{file.parent.name}/{file.name}": file.read_bytes() for file in beside}
    return sorted((python | compiled).items())


@cache
def reduce_source(source: bytes) -> bytes:
    """Return Python source without comments, docstrings and layout."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, _Documented) and ast.get_docstring(node, clean=False) is not None:
            node.body = node.body[1:] or [ast.Pass()]
    return ast.unparse(tree).encode()


@cache
def _imported(source: bytes) -> tuple[str, ...]:
    """List what a module imports from our packages; of ``from a import b`` both a and a.b, of which one may not exist."""
    names: list[str] = []
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names=imported):
                names += [one.name for one in imported if one.name.split(".")[0] in OURS]
            case ast.ImportFrom(module=str(module), names=imported, level=0) if module.split(".")[0] in OURS:
                names += [module, *(f"{module}.{one.name}" for one in imported)]
    return tuple(names)


def _file_of(name: str) -> Path | None:
    """Return the Python file of a module; None where the name is no module, as that of a class is none."""
    loaded = getattr(sys.modules.get(name), "__file__", None)
    if loaded is not None:
        return Path(loaded)
    try:
        spec = importlib.util.find_spec(name)
    except ModuleNotFoundError:
        return None
    return Path(spec.origin) if spec is not None and spec.origin is not None and spec.origin.endswith(".py") else None
