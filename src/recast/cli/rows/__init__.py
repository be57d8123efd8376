"""The tables of commands as rows for `recast.cli.output.print_json`."""
