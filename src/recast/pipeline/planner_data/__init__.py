"""Samples for training the small planner, rendered and scored; and the proof that it looks."""
