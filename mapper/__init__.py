"""Encounters in, the Geometric-Topological Persistent map out."""
