"""Published weights by name: fetched once, checked against a record, read offline afterwards."""

from recast.weights.table import (
    PUBLISHED,
    RECAST_WEIGHTS,
    Licence,
    Weights,
    WeightsSource,
    located,
    place,
    published,
    shipped_folder,
    weights_folder,
)

__all__ = [
    "PUBLISHED",
    "RECAST_WEIGHTS",
    "Licence",
    "Weights",
    "WeightsSource",
    "located",
    "place",
    "published",
    "shipped_folder",
    "weights_folder",
]
