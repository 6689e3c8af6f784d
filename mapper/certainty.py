"""How sure something is, in words."""

from typing import Final

_MOST_TOLD: Final = 0.99


def sure_text(probability: float) -> str:
    """Tell a probability; nothing is told of as certain."""
    return f"{chance_text(probability)} sure"


def chance_text(probability: float) -> str:
    """Tell it without the word *sure*."""
    if probability > _MOST_TOLD:
        return f"over {_MOST_TOLD:.0%}"
    return f"{probability:.0%}" if probability >= 1.0 - _MOST_TOLD else f"under {1.0 - _MOST_TOLD:.0%}"
