"""Vehicle sets: many views of many vehicles, with labels and a split; and folders of real crops.

See docs/data.md.
"""

from recast.recar.screening import SetStatistics, set_statistics, statistics_table
from recast.recar.synthesis import SynthesisSettings, synthesize_set
from recast.recar.vehicle_set import (
    HELD_OUT_SHARE,
    Identity,
    IdentityRecord,
    SetRecord,
    Split,
    VehicleSet,
    begin_set,
    finish_set,
    read_set,
    regular_azimuths,
    split_of,
    write_identity,
)
from recast.recar.views import (
    RealVehicle,
    RealView,
    camera_pose,
    fitting_distance,
    holds_real_crops,
    pinhole,
    read_real_crops,
)

__all__ = [
    "HELD_OUT_SHARE",
    "Identity",
    "IdentityRecord",
    "RealVehicle",
    "RealView",
    "SetRecord",
    "SetStatistics",
    "Split",
    "SynthesisSettings",
    "VehicleSet",
    "begin_set",
    "camera_pose",
    "finish_set",
    "fitting_distance",
    "holds_real_crops",
    "pinhole",
    "read_real_crops",
    "read_set",
    "regular_azimuths",
    "set_statistics",
    "split_of",
    "statistics_table",
    "synthesize_set",
    "write_identity",
]
