"""Scores of other benchmarks beside the headline metrics: NAVSIM v2, AlpaSim, NeuroNCAP."""
