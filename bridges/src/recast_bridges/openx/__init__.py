"""ASAM OpenX: scenarios and rollouts as OpenSCENARIO XML, maps as OpenDRIVE."""

from recast_bridges.openx.export import Exported, ExportedRoads, export_openx
from recast_bridges.openx.opendrive import read_opendrive, write_opendrive
from recast_bridges.openx.openscenario import (
    Entity,
    Played,
    largest_difference,
    played_rollout,
    played_scenario,
    read_openscenario,
    write_openscenario,
)

__all__ = [
    "Entity",
    "Exported",
    "ExportedRoads",
    "Played",
    "export_openx",
    "largest_difference",
    "played_rollout",
    "played_scenario",
    "read_opendrive",
    "read_openscenario",
    "write_opendrive",
    "write_openscenario",
]
