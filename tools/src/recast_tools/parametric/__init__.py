"""Data and training of the parametric model."""
