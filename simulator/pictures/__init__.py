"""Pictures of runs: stills, films, a page, and the terminal."""
