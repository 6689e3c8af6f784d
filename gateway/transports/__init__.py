"""Devices and sockets behind one byte-stream interface."""
