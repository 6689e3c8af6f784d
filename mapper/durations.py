"""Durations in words."""


def duration_text(seconds: float | None) -> str:
    """Tell a duration in a fitting unit; None is never."""
    if seconds is None:
        return "never"
    for unit_s, name in ((86_400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * unit_s:
            return f"{seconds / unit_s:.3g} {name}"
    return f"{seconds:.3g} s"
