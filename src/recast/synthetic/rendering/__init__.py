"""Ray-traced cameras and LiDAR."""
