"""Finds out what is plugged in: which dialect, at which speed, with which firmware and network; or why nothing of use answers."""
