"""The firmware of a backpack: contacts, reports, obedience."""
