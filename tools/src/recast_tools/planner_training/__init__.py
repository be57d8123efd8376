"""From a vocabulary and scored samples to a planner: the recipe of `gtrs-mini`."""
