"""HTTP as a thin skin over the finished maps."""
