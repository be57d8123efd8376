"""`recast store`: the artefacts that runs share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from recast.cli import shared
from recast.cli.output import JSON, console_for, print_json


@dataclass(frozen=True)
class StoreList:
    """List the artefacts of a store with their size, the time to make them, and their users."""

    store: tyro.conf.Positional[str]
    """Folder of the store, such as runs/store."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.cli.rows.store import list_store, opened_store, store_rows

        store = opened_store(self.store)
        list_store(store, console_for(self.json))
        if self.json:
            print_json(store_rows(store))


@dataclass(frozen=True)
class Why:
    """Print the inputs of an artefact as a tree, with the inputs of these inputs."""

    store: tyro.conf.Positional[str]
    """Folder of the store."""
    key: tyro.conf.Positional[str]
    """Key of the artefact; its first digits are enough."""

    def __call__(self) -> None:
        from recast.cli.rows.store import explain_artefact

        explain_artefact(self.store, self.key, console_for(False))


@dataclass(frozen=True)
class Prune:
    """List unused artefacts and the leftovers of killed commands; --yes removes them."""

    store: tyro.conf.Positional[str]
    """Folder of the store."""
    yes: bool = False
    """Remove the listed artefacts and leftovers."""
    older_than: float = 24.0
    """Minimum age of an artefact in hours; a younger one may belong to a run in progress."""

    def __call__(self) -> None:
        from recast.cli.rows.store import prune_store

        prune_store(self.store, self.yes, self.older_than, console_for(False))


Store = shared.group(
    "store",
    "List, explain or remove the artefacts (scenes, actors, rollouts) that runs share.",
    {"list": StoreList, "why": Why, "prune": Prune},
)
