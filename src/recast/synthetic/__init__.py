"""The procedural driving world: streets, vehicles, sensors with ground truth."""
