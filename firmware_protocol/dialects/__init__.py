"""A coordinator dongle as the base station sees it, one sibling per dialect: bytes and time in, events and bytes out."""
