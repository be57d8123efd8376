"""Parametric vehicles."""
