"""Commands that recast-tools adds to `recast`."""
