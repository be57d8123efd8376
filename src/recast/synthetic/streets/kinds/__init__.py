"""The nine kinds of street."""
