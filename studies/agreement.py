"""One figure that was measured, beside what theory says it is."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """A measured figure and its theory.

    Parameters
    ----------
    within
        Largest relative difference that counts as agreement; None for a figure that is only told, where no theory binds.
    """

    name: str
    measured: float
    theory: float
    within: float | None

    @property
    def off_by(self) -> float:
        """Relative difference, measured over theory less 1."""
        return self.measured / self.theory - 1.0

    @property
    def agrees(self) -> bool:
        """Whether the difference is within what is allowed."""
        return self.within is None or abs(self.off_by) <= self.within

    def line(self) -> str:
        """Tell it in one line."""
        allowed = "" if self.within is None else f"  (allowed {self.within:.1%}){'' if self.agrees else '  DISAGREES'}"
        return f"{self.name:64} measured {self.measured:<11.5g} theory {self.theory:<11.5g} off {self.off_by:+7.2%}{allowed}"
