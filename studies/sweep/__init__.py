"""Sweeps: runs are simulated and mapped over a grid of parameters, and told cell by cell: ``python -m studies.sweep FILE.toml``."""
