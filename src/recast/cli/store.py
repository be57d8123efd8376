"""`recast store`: the artefacts that runs share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True)
class List:
    """List the artefacts of a store: what they are, how large, and how many runs use them."""

    store: tyro.conf.Positional[str]
    """Folder of the store, such as runs/store."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.show_store import list_store

        list_store(self.store, Console())


@dataclass(frozen=True)
class Why:
    """Show what an artefact was made from, and what that was made from in turn."""

    store: tyro.conf.Positional[str]
    """Folder of the store."""
    key: tyro.conf.Positional[str]
    """Key of the artefact; its first digits are enough."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.show_store import explain_artefact

        explain_artefact(self.store, self.key, Console())


@dataclass(frozen=True)
class Prune:
    """List what no run folder refers to and what killed commands left behind; --yes removes it."""

    store: tyro.conf.Positional[str]
    """Folder of the store."""
    yes: bool = False
    """Remove what is listed."""
    older_than: float = 24.0
    """Hours since an artefact was made; younger ones may belong to a run under way."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.show_store import prune_store

        prune_store(self.store, self.yes, self.older_than, Console())


@dataclass(frozen=True)
class Store:
    """Look into the store of artefacts (scenes, actors, rollouts, ...) that runs share."""

    command: (
        Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Why, tyro.conf.subcommand("why")]
        | Annotated[Prune, tyro.conf.subcommand("prune")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
