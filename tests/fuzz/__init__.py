"""Fuzzing of every reader of foreign files: see docs/reliability.md."""
