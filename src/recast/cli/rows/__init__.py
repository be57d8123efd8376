"""What commands print: tables for people, and rows for `recast.cli.shared.print_json`."""
