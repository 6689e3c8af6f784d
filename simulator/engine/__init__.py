"""The compiled core of the simulator."""

from simulator.engine.engine import Engine

__all__ = ["Engine"]
