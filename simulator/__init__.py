"""Arenas, insects, radios and backpacks that never lived."""
