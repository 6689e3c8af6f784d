"""A study whose cases are small sums, and some of which go wrong in a chosen way."""

import math
import os
from dataclasses import dataclass

import numpy as np

from mapper.types import FloatArray
from studies.cases import Study


@dataclass(frozen=True, slots=True, kw_only=True)
class Sum:
    number: int
    how: str = "well"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Squared:
    number: int
    root: float
    rows: FloatArray
    worker: int
    threads: str | None


def square(case: Sum) -> Squared:
    match case.how:
        case "raise":
            raise ValueError(f"{case.number} is not to be squared")
        case "nan":
            root = math.nan
        case "crash":
            os._exit(3)
        case _:
            root = math.sqrt(case.number)
    rows = np.array([[case.number, case.number**2]] * (case.number % 3), dtype=np.float64).reshape(-1, 2)
    return Squared(number=case.number**2, root=root, rows=rows, worker=os.getpid(), threads=os.environ.get("OMP_NUM_THREADS"))


SQUARES = Study(name="squares", compute=square, result_type=Squared)
