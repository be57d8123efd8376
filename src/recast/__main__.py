"""`python -m recast` is the `recast` command."""

import sys

from recast.cli.main import main

if __name__ == "__main__":  # worker processes import this module, too
    sys.exit(main())
