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
        InputError: a field is missing, of another shape, not finite, or out of range
            (`Gaussians.fault`).
    """
    n = len(constant)
    rest = table.tensor(names.rest, n, None, 3)
    if rest.shape[1] not in REST_COUNTS:
        raise table.fault(
            names.rest, f"has {rest.shape[1]} harmonics, expected one of {list(REST_COUNTS)}"
        )
    found = Gaussians(
        means=table.tensor(names.means, n, 3),
        quats=table.tensor(names.quats, n, 4),
        log_scales=table.tensor(names.log_scales, n, 3),
        logit_opacities=table.tensor(names.logit_opacities, n, 1)[:, 0],
        sh=torch.cat([constant[:, None], rest], dim=1),
    )
    fault = found.fault()
    if fault is not None:
        field = names.rest if fault[0] == "sh" else getattr(names, fault[0])
        raise table.fault(field, fault[1])
    return found


def unused_members(tables: Iterable[Table], names: Names, others: Sequence[str]) -> list[str]:
    """A sentence on what the tables hold beside Gaussians and `others`; none where that is all."""
    known = {*astuple(names), *others}
    found = sorted({name for table in tables for name in table if name not in known})
    return [f"in the models: {', '.join(found)}"] if found else []
