"""Samples for training the small GTRS planner, rendered and scored."""
