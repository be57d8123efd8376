"""The six networks, under their published class names."""
