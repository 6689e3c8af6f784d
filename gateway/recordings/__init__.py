"""Recordings of lines to dongles: the file, what its bytes say, and other tools' forms of it."""
