"""What base station and Z-Stack network processor say to each other: commands as values, and their bytes."""
