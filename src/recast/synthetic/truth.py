"""What a log cannot hold: exact depth and whose every pixel is, beside it in the folder `truth`.

Layout: truth.json, and for each camera and frame `CAMERA/depth_NNNN.npz` (member "depth", float32
metres along the camera's z axis, infinite where the sky is) and `CAMERA/instance_NNNN.png` (16 bit:
0 street, 65535 sky, others as `TruthRecord.instances` says).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from pydantic import BaseModel, ConfigDict

from recast import records, storage
from recast.errors import InputError

FOLDER = "truth"
RECORD = "truth.json"
VERSION = 1


class TruthRecord(BaseModel):
    """The contents of truth.json.

    Attributes:
        frames: by camera.
        instances: track id by the value of its pixels.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    format: Literal["recast-truth"] = "recast-truth"
    version: Literal[1] = 1
    street: Literal[0] = 0
    sky: Literal[65535] = 65535
    frames: dict[str, int]
    instances: dict[int, str]


@dataclass(frozen=True)
class Truth:
    """Reads the folder; frames are decoded when asked for.

    Attributes:
        folder: that of truth.json.
        record: its contents.
    """

    folder: Path
    record: TruthRecord

    def depth(self, camera: str, frame: int) -> NDArray[np.float32]:
        """(height, width) metres along z, infinite where the sky is."""
        self._check(camera, frame)
        with np.load(depth_file(self.folder, camera, frame), allow_pickle=False) as archive:
            depth: NDArray[np.float32] = archive["depth"]
        return depth

    def instance(self, camera: str, frame: int) -> NDArray[np.uint16]:
        """(height, width) whose each pixel is."""
        self._check(camera, frame)
        with PillowImage.open(instance_file(self.folder, camera, frame)) as image:
            return np.asarray(image).astype(np.uint16)

    def _check(self, camera: str, frame: int) -> None:
        count = self.record.frames.get(camera, 0)
        if not 0 <= frame < count:
            known = ", ".join(f"{key} 0-{n - 1}" for key, n in self.record.frames.items())
            raise InputError(
                self.folder, f"{camera} frame {frame}", "is not there", f"choose of {known}"
            )


def read_truth(log_folder: str | Path) -> Truth:
    """The truth beside a log.

    Raises:
        InputError: there is none, or truth.json is broken or of another version.
    """
    folder = Path(log_folder) / FOLDER
    mend = "make the log anew: recast log synth --truth"
    if not (folder / RECORD).is_file():
        raise InputError(folder, RECORD, "is missing", mend)
    record = records.read_record(folder / RECORD, TruthRecord, VERSION, mend, "recast-truth")
    return Truth(folder, record)


def write_truth_record(folder: Path, record: TruthRecord) -> None:
    """Write truth.json into `folder`."""
    storage.write_json(folder / RECORD, record.model_dump())


def write_truth_frame(
    folder: Path,
    camera: str,
    frame: int,
    depth: NDArray[np.float32],
    instance: NDArray[np.uint16],
) -> None:
    """Write the two files of a frame."""
    path = depth_file(folder, camera, frame)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, depth=depth.astype(np.float32))
    PillowImage.fromarray(instance.astype(np.uint16)).save(instance_file(folder, camera, frame))


def depth_file(folder: Path, camera: str, frame: int) -> Path:
    """Path of a depth map."""
    return folder / camera / f"depth_{frame:04d}.npz"


def instance_file(folder: Path, camera: str, frame: int) -> Path:
    """Path of an instance mask."""
    return folder / camera / f"instance_{frame:04d}.png"
