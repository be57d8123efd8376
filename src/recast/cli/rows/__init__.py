"""What commands print: tables for people, and rows for `recast.cli.output.print_json`."""
