"""A small training run that the tests of this folder share."""

from support.tiny_street import told, trained

__all__ = ["told", "trained"]
