"""`recast doctor` and `recast weights`: what this machine has, and published weights by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from recast.cli import shared
from recast.cli.output import JSON, console_for, print_json

_NAME = tyro.conf.arg(metavar="NAME")


@dataclass(frozen=True)
class Doctor:
    """Print versions, the CPU kernel, CUDA and optional parts, and how to install missing ones."""

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

    name: Annotated[tyro.conf.Positional[str | None], _NAME] = None
    """Name of downloaded weights (default: all)."""

    def __call__(self) -> None:
        from recast.cli.rows.machine import verify_weights

        verify_weights(self.name, console_for(False))


@dataclass(frozen=True)
class Path:
    """Print the folder or file of downloaded weights."""

    name: Annotated[tyro.conf.Positional[str], _NAME]
    """Name of downloaded weights."""

    def __call__(self) -> None:
        from recast.weights import published
        from recast.weights.fetched import opened

        print(opened(published(self.name)))


Weights = shared.group(
    "weights",
    "List, download and check published weights; recast downloads nothing else.",
    {"list": WeightsList, "get": Get, "verify": WeightsVerify, "path": Path},
)
