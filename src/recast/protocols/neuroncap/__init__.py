"""NeuroNCAP: recast as its renderer, its planners in recast's loop, and its scenarios."""
