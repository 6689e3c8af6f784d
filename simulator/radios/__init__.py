"""The air: channel, shared medium, beacons and what is heard of them, and coordinators' coverage."""
