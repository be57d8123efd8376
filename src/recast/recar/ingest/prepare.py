"""From the photographs of one vehicle to the files of the set, in memory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.recar.ingest.background import BackgroundRemover
from recast.recar.ingest.perceptual_hash import Hashes, first_twice, perceptual_hash
from recast.recar.ingest.photograph import fit, read_mask, read_photograph
from recast.recar.ingest.settings import IngestSettings
from recast.recar.ingest.table import VehicleRow
from recast.recar.picture import encode_picture


@dataclass(frozen=True)
class Candidate:
    """A vehicle to bring in.

    Attributes:
        row: of the table.
        photographs: by azimuth.
        masks: of each photograph, None where there is none; empty where there are none at all.
        doubts: what a person should look at.
    """

    row: VehicleRow
    photographs: tuple[Path, ...]
    masks: tuple[Path | None, ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Prepared:
    """PNG and hash of each view of a vehicle, and what a person should look at."""

    pictures: tuple[bytes, ...]
    hashes: Hashes
    doubts: tuple[str, ...]


def prepare(
    candidate: Candidate, settings: IngestSettings, remover: BackgroundRemover | None
) -> Prepared:
    """Remove backgrounds, bring to size, encode, and compare the views with each other.

    Raises:
        InputError: a photograph or a mask is broken, a photograph without alpha where there is
            neither a mask nor a remover, or transparent everywhere; or two are the same.
    """
    pictures: list[bytes] = []
    hashes: list[Hashes] = []
    doubts = list(candidate.doubts)
    masks = candidate.masks or (None,) * len(candidate.photographs)
    for path, mask in zip(candidate.photographs, masks, strict=True):
        rgb, alpha = read_photograph(path)
        if mask is not None:
            alpha = read_mask(mask, rgb.shape[1::-1])
        elif alpha is None:
            if remover is None:
                raise InputError(
                    path, "alpha", "is absent", "cut out the background, or name a --remover"
                )
            cutout = remover.remove(rgb, candidate.row.category)
            alpha = cutout.alpha
            doubts += [f"{path.name}: {doubt}" for doubt in cutout.doubts]
        picture = fit(rgb, alpha, settings.width, settings.height)
        if not picture[..., 3].any():
            raise InputError(path, "alpha", "is zero everywhere: no vehicle was found",
                             "cut it out by hand")  # fmt: skip
        pictures.append(encode_picture(picture))
        hashes.append(perceptual_hash(picture))
    stacked = np.stack(hashes)
    if twice := first_twice(stacked, settings.duplicate_bits):
        first, second = (candidate.photographs[index] for index in twice)
        raise InputError(
            second, "duplicate", f"is the same picture as {first.name}",
            "replace it; if both are right, lower --duplicate-bits",
        )  # fmt: skip
    return Prepared(tuple(pictures), stacked, tuple(doubts))
