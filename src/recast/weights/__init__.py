"""Published weights by name: fetched once, checked against a record, read offline afterwards."""

from recast.weights.fetched import RECAST_WEIGHTS, located, place, shipped_folder, weights_folder
from recast.weights.table import PUBLISHED, Licence, Weights, WeightsSource, published

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
