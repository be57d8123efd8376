"""Other programs' languages for recast: simulators, benchmarks, published streets, files.

The core finds all parts through the entry points of this distribution.
"""

PAGES = {
    "recast_bridges.alpasim": "docs/howto/alpasim.md",
    "recast_bridges.alpasim.driver": "docs/howto/alpasim.md#drivers-as-planners",
    "recast_bridges.alpasim.driver_session": "docs/howto/alpasim.md#drivers-as-planners",
    "recast_bridges.harmonizer": "docs/runs.md#restored-images",
    "recast_bridges.neuroncap": "docs/howto/neuroncap.md",
    "recast_bridges.serve": "docs/howto/alpasim.md",
    "recast_bridges.scenes": "docs/scenes.md#scenes-that-others-trained",
}
"""Page of recast's documentation by module or package, for errors that they raise."""
