"""The services on a machine that runs systemd: users, folders, units, names of dongles, upgrade and removal."""
