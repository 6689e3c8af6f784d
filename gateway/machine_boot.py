"""The kernel's name for the time since the machine booted: within it the monotonic clock counts on."""

import contextlib
from pathlib import Path

_MACHINE_BOOT = Path("/proc/sys/kernel/random/boot_id")


def read_machine_boot() -> str:
    """Return the name; empty where the kernel gives none."""
    with contextlib.suppress(OSError):
        return _MACHINE_BOOT.read_text(encoding="ascii").strip()
    return ""
