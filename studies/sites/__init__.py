"""Two sites on two routers that are joined, over cables that are cut and healed: ``python -m studies.sites`` (docs/sites.md)."""
