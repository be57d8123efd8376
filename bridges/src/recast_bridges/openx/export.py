"""A folder of OpenSCENARIO files with the map beside them, each read back and compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from recast.core.files import atomic_folder, folder_name
from recast.logs.hdmap import HdMap
from recast_bridges.openx.opendrive import (
    LeftOutLinks,
    lane_differences,
    read_opendrive,
    write_opendrive,
)
from recast_bridges.openx.openscenario import (
    Played,
    largest_difference,
    read_openscenario,
    write_openscenario,
)

ROAD_FILE = "map.xodr"


@dataclass(frozen=True)
class Exported:
    """What was written of a scenario, and how far what is read back is from it.

    Attributes:
        file: its name in the folder.
        entities: number of road users.
        metres, seconds: largest difference of box corners and of times.
    """

    file: str
    entities: int
    metres: float
    seconds: float


@dataclass(frozen=True)
class ExportedRoads:
    """What was written of a map.

    Attributes:
        lanes: number of lanes.
        metres: largest distance of a lane boundary in the file from the map's, either way.
        centreline_metres: the same of the centrelines.
        left_out: links and neighbours that the format cannot express.
    """

    lanes: int
    metres: float
    centreline_metres: float
    left_out: LeftOutLinks


def export_openx(
    played: Sequence[Played], hdmap: HdMap | None, folder: str | Path, map_name: str = ""
) -> tuple[list[Exported], ExportedRoads | None]:
    """Write NAME.xosc of each scenario and map.xodr, which they name, if there are lanes.

    Raises:
        InputError: `folder` exists, or the disk refuses.
    """
    exported: list[Exported] = []
    roads = None
    with atomic_folder(folder) as partial:
        if hdmap is not None and hdmap.lanes:
            roads = _roads(hdmap, partial / ROAD_FILE, map_name)
        for number, one in enumerate(played):
            name = folder_name(one.name)
            taken = {other.file.lower() for other in exported}
            file = (
                f"{name}.xosc" if f"{name}.xosc".lower() not in taken else f"{name}-{number}.xosc"
            )
            write_openscenario(partial / file, one, None if roads is None else ROAD_FILE)
            apart = largest_difference(one, read_openscenario(partial / file))
            exported.append(Exported(file, len(one.entities), *apart))
    return exported, roads


def _roads(hdmap: HdMap, path: Path, name: str) -> ExportedRoads:
    left_out = write_opendrive(path, hdmap, name)
    back = read_opendrive(path)
    apart = [lane_differences(lane, back[key]) for key, lane in hdmap.lanes.items()]
    boundaries, centrelines = (max(column) for column in zip(*apart, strict=True))
    return ExportedRoads(len(back), boundaries, centrelines, left_out)
