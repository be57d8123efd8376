"""`recast doctor`, `weights`, `store` and `trellis`: what this machine and its folders have."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from recast.cli import shared
from recast.cli.shared import JSON, console_for, print_json

_NAME = tyro.conf.arg(metavar="NAME")


@dataclass(frozen=True)
class Doctor:
    """Print versions, the CPU kernel, CUDA and all extras, and how to install missing ones."""

    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.cli.rows.machine import examine, findings_table

        findings = examine()
        if self.json:
            from recast.cli.rows.machine import finding_rows

            print_json(finding_rows(findings))
            return
        console_for(False).print(findings_table(findings))


@dataclass(frozen=True)
class WeightsList:
    """List the published weights that recast can download: use, size, licence, commit."""

    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        if self.json:
            from recast.cli.rows.machine import weights_rows

            print_json(weights_rows())
            return
        from recast.cli.rows.machine import weights_table

        console_for(False).print(weights_table())


@dataclass(frozen=True)
class Get:
    """Download weights over the network; weights that are present are not downloaded again.

    An interrupted download resumes. The variable RECAST_WEIGHTS names the folder of the weights,
    RECAST_WEIGHTS_MIRROR or HF_ENDPOINT a mirror.
    """

    name: Annotated[tyro.conf.Positional[str], _NAME]
    """Name that `recast weights list` shows."""
    accept_licence: bool = False
    """Accept the licence terms of restricted weights without a question."""

    def __call__(self) -> None:
        from recast.cli.rows.machine import get_weights

        get_weights(self.name, self.accept_licence, console_for(False))


@dataclass(frozen=True)
class WeightsVerify:
    """Read every byte of downloaded weights and compare it with the record of the download."""

    name: Annotated[tyro.conf.Positional[str | None], shared.several("NAME", "default: all")] = None
    """Name of downloaded weights."""

    def __call__(self) -> None:
        from recast.cli.rows.machine import verify_weights

        verify_weights(self.name, console_for(False))


@dataclass(frozen=True)
class WeightsPath:
    """Print the folder or file of downloaded weights."""

    name: Annotated[tyro.conf.Positional[str], _NAME]
    """Name of downloaded weights."""

    def __call__(self) -> None:
        from recast.weights import published
        from recast.weights.table import opened

        print(opened(published(self.name)))


Weights = shared.group(
    "weights",
    "List, download and check published weights; recast downloads nothing else.",
    {"list": WeightsList, "get": Get, "verify": WeightsVerify, "path": WeightsPath},
)


@dataclass(frozen=True)
class StoreList:
    """List the artefacts of a store with their size, the time to make them, and their users."""

    store: tyro.conf.Positional[str]
    """Folder of the store, such as runs/store."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.cli.rows.machine import list_store, opened_store, store_rows

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
        from recast.cli.rows.machine import explain_artefact

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
        from recast.cli.rows.machine import prune_store

        prune_store(self.store, self.yes, self.older_than, console_for(False))


Store = shared.group(
    "store",
    "List, explain or remove the artefacts (scenes, actors, rollouts) that runs share.",
    {"list": StoreList, "why": Why, "prune": Prune},
)


@dataclass(frozen=True)
class TrellisVerify:
    """Check names, shapes, types and sizes of the weights in a model folder."""

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder in the published layout (pipeline.json and ckpts/), recast-mini (in the package) or
    trellis (recast weights)."""
    values: bool = False
    """Read every tensor, and check that all values are finite."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.trellis.checkpoints import (
            check_details,
            check_table,
            first_fault,
            verify_checkpoint,
        )
        from recast.weights import located

        folder = located("--model", self.folder)
        checks = verify_checkpoint(folder, values=self.values)
        console = console_for(self.json)
        if self.json:
            from recast.cli.rows.results import check_rows

            print_json(check_rows(checks))
        else:
            console.print(check_table(checks, folder))
        for check in checks:
            for line in check_details(check):
                console.print(line, markup=False, highlight=False, soft_wrap=True)
        fault = first_fault(checks)
        if fault is not None:
            raise fault


@dataclass(frozen=True)
class TrellisExport:
    """Write the weights that generation needs, in half precision, to a smaller model folder."""

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder in the published layout (pipeline.json and ckpts/), recast-mini (in the package) or
    trellis (recast weights)."""
    out: Path
    """New model folder."""

    def __call__(self) -> None:
        from recast.trellis.checkpoints import export_model
        from recast.weights import located

        export_model(located("--model", self.folder), self.out)
        size = sum(path.stat().st_size for path in self.out.rglob("*") if path.is_file())
        console_for(False).print(
            f"wrote {self.out}: {size / 1e6:.1f} MB", markup=False, soft_wrap=True
        )


Trellis = shared.group(
    "trellis",
    "Check or export model folders of the image-to-3D model.",
    {"verify": TrellisVerify, "export": TrellisExport},
)
