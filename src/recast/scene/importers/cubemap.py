"""The sky cubemap of a checkpoint."""

from __future__ import annotations

from torch import Tensor

from recast.scene.importers.table import Table

RESAMPLED = "sky cubemap, resampled"
NO_SKY = "sky: the checkpoint has none; it is black"


def read_faces(table: Table, name: str) -> Tensor:
    """A checkpoint's cubemap (6, R, R, 3).

    Raises:
        InputError: it is missing, of another shape, or not finite.
    """
    faces = table.tensor(name, 6, None, None, 3)
    if faces.shape[1] != faces.shape[2] or faces.shape[1] == 0:
        raise table.fault(name, f"has faces of {list(faces.shape[1:3])}, which are no squares")
    return faces
