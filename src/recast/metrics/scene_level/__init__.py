"""Rendering quality of whole scenes (RECAST, section 5, Q2): images, features, scores, table."""
