"""The nine street scenes."""
