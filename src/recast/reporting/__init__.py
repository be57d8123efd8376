"""Reports of runs: films, bird's-eye views, plots, tables, one self-contained page."""
