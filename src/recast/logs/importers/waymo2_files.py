"""Where the components of a Waymo v2 segment lie."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from recast.errors import InputError
from recast.logs.importers.drive_names import check_drive
from recast.logs.importers.waymo2_tables import Table

COMPONENTS = {
    "vehicle_pose": "VehiclePoseComponent",
    "camera_calibration": "CameraCalibrationComponent",
    "camera_image": "CameraImageComponent",
    "lidar_calibration": "LiDARCalibrationComponent",
    "lidar": "LiDARComponent",
    "lidar_pose": "LiDARPoseComponent",
    "lidar_box": "LiDARBoxComponent",
    "stats": "StatsComponent",
}
"""Folders that are read, and the name of the component in the names of its columns."""
_LISTED = 5


@dataclass(frozen=True)
class Components:
    """The files of a segment: `folder`/COMPONENT/`segment`.parquet."""

    folder: Path
    segment: str

    def has(self, name: str) -> bool:
        """Whether a component was downloaded: people take only those they need."""
        return (self.folder / name).is_dir()

    def table(self, name: str) -> Table:
        """The table of a component.

        Raises:
            InputError: it is missing.
        """
        path = self.folder / name / f"{self.segment}.parquet"
        if not path.is_file():
            raise InputError(path, "file", "is missing", f"download the component {name}")
        return Table(path, COMPONENTS[name])

    def left_out(self) -> list[str]:
        """Components that are not there."""
        return [name for name in COMPONENTS if not self.has(name)]


def find_segment(root: Path, drive: str) -> Components:
    """The segment `drive` in `root`, which holds the components or the splits that hold them.

    Raises:
        InputError: the folder or the segment does not exist, or is in several splits.
    """
    if not root.is_dir():
        raise InputError(root, "Waymo v2 folder", "does not exist", "check the path")
    splits = [root, *sorted(path for path in root.iterdir() if path.is_dir())]
    name = drive.removesuffix(".parquet")
    check_drive(root, name)
    found = [split for split in splits if (split / "vehicle_pose" / f"{name}.parquet").is_file()]
    if len(found) > 1:
        listed = ", ".join(split.name for split in found)
        raise InputError(root, f"drive {name}", f"is in {listed}", "name the folder of one split")
    if found:
        return Components(found[0], name)
    others = sorted(path.stem for split in splits for path in split.glob("vehicle_pose/*.parquet"))
    shown = ", ".join(others[:_LISTED])
    if len(others) > _LISTED:
        shown += f" and {len(others) - _LISTED} more"
    mend = f"choose one of {shown}" if others else "name the folder that holds vehicle_pose"
    raise InputError(root, f"drive {name}", "has no file in vehicle_pose", mend)
