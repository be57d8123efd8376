"""What stands beside roads."""
