"""Builds the images of docker/ and runs its compose files for real, without a Docker engine: ``python -m scripts.containers --help``."""
