"""The acceptance check of whatever is plugged in: one verdict for each capability (docs/hardware-in-the-loop.md)."""
