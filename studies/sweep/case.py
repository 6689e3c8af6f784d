"""A case of a sweep: what is not as by default, by dotted key, and a seed."""

from collections.abc import Mapping
from typing import Any

import msgspec

from mapper.config import RecipeConfig
from simulator.config import RunConfig

Value = Any
"""What JSON can hold."""
Cell = Mapping[str, Value]
"""Dotted keys such as ``run.preset`` and ``recipe.metric``, and their values."""


class SweepCase(msgspec.Struct, frozen=True, kw_only=True):
    """One run, simulated and mapped.

    Parameters
    ----------
    cell
        What is not as by default.
    seed
        Of the run.
    files
        SHA-256 of the arena files named in the cell, by path.
    """

    cell: dict[str, Value]
    seed: int
    files: dict[str, str] = {}


def part(cell: Cell, name: str) -> dict[str, Any]:
    """Return the keys of a cell under ``name``, as nested tables."""
    nested: dict[str, Any] = {}
    for dotted, value in cell.items():
        first, *path, last = dotted.split(".")
        if first == name:
            table = nested
            for key in path:
                table = table.setdefault(key, {})
            table[last] = value
    return nested


def run_config(cell: Cell, *, seed: int) -> RunConfig:
    """Return what ``biobot-sim run`` would be told."""
    return msgspec.convert(part(cell, "run") | {"seed": seed}, RunConfig)


def recipe_config(cell: Cell) -> RecipeConfig:
    """Return what ``biobot-mapper run`` would be told."""
    return msgspec.convert(part(cell, "recipe"), RecipeConfig)


def arena_files(cell: Cell) -> list[str]:
    """List the arena files that a cell names."""
    later = [text.partition(":")[2] for text in cell.get("run.arena_then", ())]
    return [path for path in (cell.get("run.arena"), *later) if path is not None]
