"""`recast weights`: published weights, fetched by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

_NAME = tyro.conf.arg(metavar="NAME")


@dataclass(frozen=True)
class List:
    """List the weights that recast knows: what for, size, licence, who pins them, whether here."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.show_weights import weights_table

        Console().print(weights_table())


@dataclass(frozen=True)
class Get:
    """Fetch weights, or find them: a second call asks nothing of the network.

    A transfer that was cut goes on where it stopped. RECAST_WEIGHTS names the folder,
    RECAST_WEIGHTS_MIRROR or HF_ENDPOINT a mirror.
    """

    name: Annotated[tyro.conf.Positional[str], _NAME]
    """Name, see recast weights list."""
    accept_licence: bool = False
    """Accept the terms that are shown, where weights ask for it."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.show_weights import get_weights

        get_weights(self.name, self.accept_licence, Console())


@dataclass(frozen=True)
class Verify:
    """Read every byte of fetched weights and compare it with the record of the download."""

    name: Annotated[tyro.conf.Positional[str | None], _NAME] = None
    """Name; all that are here where not given."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.show_weights import verify_weights

        verify_weights(self.name, Console())


@dataclass(frozen=True)
class Path:
    """Print the folder or file that a name stands for."""

    name: Annotated[tyro.conf.Positional[str], _NAME]
    """Name of fetched weights."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.weights import published
        from recast.weights.place import opened

        print(opened(published(self.name)))


@dataclass(frozen=True)
class Weights:
    """Fetch published weights by name; recast downloads nothing else."""

    command: (
        Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Get, tyro.conf.subcommand("get")]
        | Annotated[Verify, tyro.conf.subcommand("verify")]
        | Annotated[Path, tyro.conf.subcommand("path")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
