"""Gaussians out of a checkpoint's tables, whatever the names they go by."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass

import torch
from torch import Tensor

from recast.scene.importers.table import Table
from recast.splats import Gaussians

REST_COUNTS = (0, 3, 8, 15)
"""Harmonics above the constant one, by degree."""


@dataclass(frozen=True)
class Names:
    """What a layout calls the fields of Gaussians but the constant harmonic."""

    means: str
    rest: str
    log_scales: str
    quats: str
    logit_opacities: str


def read_gaussians(table: Table, names: Names, constant: Tensor) -> Gaussians:
    """The Gaussians of a table.

    Args:
        constant: (N, 3) constant harmonics, which layouts store in different ways.

    Raises:
        InputError: a field is missing, of another shape, not finite, or a quaternion is zero.
    """
    n = len(constant)
    rest = table.tensor(names.rest, n, None, 3)
    if rest.shape[1] not in REST_COUNTS:
        raise table.fault(
            names.rest, f"has {rest.shape[1]} harmonics, expected one of {list(REST_COUNTS)}"
        )
    quats = table.tensor(names.quats, n, 4)
    zero = (quats.norm(dim=1) == 0).nonzero()
    if len(zero):
        raise table.fault(names.quats, f"row {int(zero[0])} is a quaternion of norm zero")
    return Gaussians(
        means=table.tensor(names.means, n, 3),
        quats=quats,
        log_scales=table.tensor(names.log_scales, n, 3),
        logit_opacities=table.tensor(names.logit_opacities, n, 1)[:, 0],
        sh=torch.cat([constant[:, None], rest], dim=1),
    )


def unused_members(tables: Iterable[Table], names: Names, others: Sequence[str]) -> list[str]:
    """A sentence on what the tables hold beside Gaussians and `others`; none where that is all."""
    known = {*astuple(names), *others}
    found = sorted({name for table in tables for name in table if name not in known})
    return [f"in the models: {', '.join(found)}"] if found else []
