"""What is said between base station, coordinator and backpacks, and what is published of it."""
