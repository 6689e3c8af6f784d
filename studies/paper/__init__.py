"""The experiments of [Dir16], a module each: ``python -m studies.paper.scenarios`` and so on; ``python -m studies.paper`` runs all."""
