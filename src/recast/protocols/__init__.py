"""Other simulators' wire formats: recast as their renderer, and their renderers for recast."""
