"""Faults of pictures from driving logs, put on clean conditioning pictures (paper, Stage II)."""

from recast.recar.perturb.compose import (
    PerturbationConfig,
    Perturbed,
    perturb,
    read_perturbations,
    write_perturbations,
)
from recast.recar.perturb.kind import PerturbationKind

__all__ = [
    "PerturbationConfig",
    "PerturbationKind",
    "Perturbed",
    "perturb",
    "read_perturbations",
    "write_perturbations",
]
