"""Commands that recast-bridges adds to `recast`."""
