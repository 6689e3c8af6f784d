"""Many native frames at once, into columns: what recordings are read with."""
