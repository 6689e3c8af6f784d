"""Installs, upgrades, breaks and removes the services on a machine of their own, under systemd: ``make install-check``."""
