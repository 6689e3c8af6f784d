"""Virtual coordinator dongles, one sibling per dialect: the line's bytes on one side, radio payloads on the other."""
