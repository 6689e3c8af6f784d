"""Bytes to frames and back, one sibling module per dialect."""
