"""`recast completion`: completion of commands and options in a shell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import tyro


@dataclass(frozen=True)
class Completion:
    """Print the completion script of a shell; docs/install.md says how to install it."""

    shell: tyro.conf.Positional[Literal["bash", "zsh", "fish"]]
    """Shell that completes `recast`."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.cli.main import completion_script

        print(completion_script(self.shell), end="")
