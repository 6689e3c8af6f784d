"""Experiments: the one place where simulator and mapper meet."""
