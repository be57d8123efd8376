"""What networks make of the images of an arm in a scene: arrays by name, and their file.

| array | shape | |
|---|---|---|
| `drawn` | (N,) bool | whether the image could be rendered; the rows of others are NaN |
| `frame_toy`, `crop_toy` | (N, 128) | `ToyFeatures` |
| `frame_inception`, `crop_inception` | (N, 2048) | |
| `frame_clip`, `frame_clip_padded`, `crop_clip` | (N, D) | unit length |
| `text_clip` | (7, D) | of the positive prompts, the negative ones and "vehicle" |
| `lpips` | (N,) | mean over the scene's reference crops |
| `vqa` | (N, 6) | scores of the positive prompts, then the negative ones |
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast import storage
from recast.errors import InputError

Array = NDArray[np.float64]
Features = Mapping[str, NDArray[np.generic]]

FEATURES_FILE = "features.npz"
OF_TEXTS = ("text_clip",)
"""Arrays without a row an image."""
_MEND = "remove the artefact that holds it, and run again"
_LARGEST = 1 << 32  # bytes


def save_features(features: Features, path: Path) -> None:
    """Write arrays, whole or not at all; the same arrays give the same bytes."""
    with storage.atomic_file(path) as partial, partial.open("wb") as file:
        np.savez(file, allow_pickle=False, **features)


def load_features(path: Path) -> Features:
    """Read what `save_features` wrote.

    Raises:
        InputError: the file is missing or damaged, or an array has another number of rows.
    """
    if not path.is_file():
        raise InputError(path, "features", "are missing", _MEND)
    if path.stat().st_size > _LARGEST:
        raise InputError(path, "features", "are larger than 4 GiB", _MEND)
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
    except (OSError, ValueError, zipfile.BadZipFile, MemoryError) as error:
        raise InputError(path, "features", f"cannot be read ({error})", _MEND) from None
    drawn = found.get("drawn")
    if drawn is None or drawn.dtype != np.bool_ or drawn.ndim != 1:
        raise InputError(path, "drawn", "is missing or not boolean", _MEND)
    for name, array in found.items():
        if name not in OF_TEXTS and len(array) != len(drawn):
            raise InputError(path, name, f"has {len(array)} rows, not {len(drawn)}", _MEND)
    return found
