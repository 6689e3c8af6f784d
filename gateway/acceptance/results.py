"""What the acceptance check found: one result for each capability, and whether the dongle passes."""

from dataclasses import dataclass, field
from enum import Enum


class Outcome(Enum):
    """How a check ended."""

    PASSED = "passed"
    FAILED = "failed"
    SKIPPED = "skipped"
    """It could not be tried; the detail says why. A required check that was skipped is not passed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The end of one check.

    Parameters
    ----------
    detail
        What was seen, or why it failed or was skipped.
    figures
        What was measured, by name with its unit.
    is_required
        Without it the dongle does not pass.
    """

    name: str
    outcome: Outcome
    detail: str = ""
    figures: dict[str, float] = field(default_factory=dict)
    is_required: bool = True


@dataclass(slots=True, kw_only=True)
class Report:
    """All results of one run, in order."""

    port: str
    results: list[Result] = field(default_factory=list)

    @property
    def is_passed(self) -> bool:
        """All that is required was tried and passed."""
        return bool(self.results) and all(one.outcome is Outcome.PASSED for one in self.results if one.is_required)

    @property
    def n_failed(self) -> int:
        """How many checks failed, required or not."""
        return sum(one.outcome is Outcome.FAILED for one in self.results)


def passed(name: str, detail: str = "", *, is_required: bool = True, **figures: float) -> Result:
    """Return the result of a check that was passed."""
    return Result(name=name, outcome=Outcome.PASSED, detail=detail, figures=figures, is_required=is_required)


def failed(name: str, detail: str, *, is_required: bool = True, **figures: float) -> Result:
    """Return the result of a check that failed; the detail says what was wanted."""
    return Result(name=name, outcome=Outcome.FAILED, detail=detail, figures=figures, is_required=is_required)


def skipped(name: str, why: str, *, is_required: bool = False) -> Result:
    """Return the result of a check that could not be tried."""
    return Result(name=name, outcome=Outcome.SKIPPED, detail=why, is_required=is_required)
