"""A study: how one case is computed, by what a case is known, and how its result is written down."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np

from studies.cases.program import PackageFile
from studies.errors import ResultError

CaseT = TypeVar("CaseT")
ResultT = TypeVar("ResultT")

_DIGEST_LENGTH = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class Study(Generic[CaseT, ResultT]):
    """How the cases of one study are computed and kept.

    Parameters
    ----------
    name
        Stands at the head of the journal, so that one study does not take another's results for its own.
    compute
        A function of a module: the result of a case follows from the case alone. Runs in other processes.
    result_type
        What it returns: a dataclass or ``msgspec.Struct`` of numbers, texts, enums, tuples, and arrays of shape (m, 2).
    key
        What of a case its result depends on, the whole case if None; two cases with the same key are one.
    files
        Files in our packages that a result depends on and that are not Python or C.
    """

    name: str
    compute: Callable[[CaseT], ResultT]
    result_type: type[ResultT]
    key: Callable[[CaseT], object] | None = None
    files: tuple[PackageFile, ...] = ()

    def digest(self, case: CaseT) -> str:
        """Name a case by its key."""
        return digest(self.key_of(case))

    def key_of(self, case: CaseT) -> object:
        """Return what the result of a case depends on."""
        return case if self.key is None else self.key(case)

    def pack(self, result: ResultT) -> Any:
        """Turn a result into what JSON can hold.

        Raises
        ------
        ResultError
            It holds something that JSON cannot, such as nan.
        """
        try:
            packed = plain(result)
            json.dumps(packed, allow_nan=False)
        except (TypeError, ValueError, NotImplementedError) as error:
            raise ResultError(study=self.name, problem=str(error)) from error
        return packed

    def unpack(self, packed: Any) -> ResultT:
        """Turn it back.

        Raises
        ------
        ResultError
            It is no result of this study.
        """
        try:
            return msgspec.convert(packed, self.result_type, dec_hook=_to_array)
        except (msgspec.ValidationError, TypeError, ValueError, NotImplementedError) as error:
            raise ResultError(study=self.name, problem=str(error)) from error


def digest(value: object) -> str:
    """Name a value by its content: the order of keys does not matter, everything else does.

    Notes
    -----
    The first 128 bits of the SHA-256 of its canonical JSON. A whole number and the same number as a float are two values.
    """
    content = json.dumps(plain(value), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(content.encode()).hexdigest()[:_DIGEST_LENGTH]


def plain(value: object) -> Any:
    """Turn dataclasses, Structs, enums and arrays into dicts, lists, texts and numbers."""
    return msgspec.to_builtins(value, enc_hook=_from_array)


def _from_array(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise NotImplementedError(f"{type(value).__name__} {value!r} has no place in JSON; give numbers, texts, tuples or arrays")


def _to_array(wanted: Any, value: object) -> object:
    origin = getattr(wanted, "__origin__", wanted)
    if isinstance(origin, type) and issubclass(origin, np.ndarray):
        return np.array(value, dtype=np.float64).reshape(-1, 2)
    raise NotImplementedError(f"{wanted} cannot be read from JSON; give numbers, texts, tuples or arrays")
