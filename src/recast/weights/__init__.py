"""Published weights by name: fetched once, checked against a record, read offline afterwards."""

from recast.weights.fetched import RECAST_WEIGHTS, located, place, shipped_folder, weights_folder
from recast.weights.table import PUBLISHED, Licence, Source, Weights, published

__all__ = [
    "PUBLISHED",
    "RECAST_WEIGHTS",
    "Licence",
    "Source",
    "Weights",
    "located",
    "place",
    "published",
    "shipped_folder",
    "weights_folder",
]
