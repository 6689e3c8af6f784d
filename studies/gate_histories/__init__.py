"""Random histories of the stimulation gate, judged at the electrode of the simulated backpack (docs/gate-histories.md)."""
