"""The `recast` command: argument handling, one file a verb group."""
