"""What stands beside roads: every function gives a `Surface` that stands on z = 0.

`rng` chooses all that is not given. Impossible sizes, counts and speeds, and unknown styles, kinds
and states raise `InputError`.
"""

from recast.synthetic.scenery.buildings import BUILDING_STYLES, building
from recast.synthetic.scenery.furniture import (
    SIGN_KINDS,
    SIGNAL_STATES,
    bench,
    bollard,
    hydrant,
    lamp_post,
    litter_bin,
    parking_meter,
    pole_line,
    road_sign,
    traffic_signal,
)
from recast.synthetic.scenery.industry import (
    WALL_STYLES,
    bridge,
    container,
    guard_rail,
    hoarding,
    pallets,
    wall,
)
from recast.synthetic.scenery.trees import FENCE_STYLES, TREE_STYLES, bush, fence, hedge, tree

__all__ = [
    "BUILDING_STYLES",
    "FENCE_STYLES",
    "SIGNAL_STATES",
    "SIGN_KINDS",
    "TREE_STYLES",
    "WALL_STYLES",
    "bench",
    "bollard",
    "bridge",
    "building",
    "bush",
    "container",
    "fence",
    "guard_rail",
    "hedge",
    "hoarding",
    "hydrant",
    "lamp_post",
    "litter_bin",
    "pallets",
    "parking_meter",
    "pole_line",
    "road_sign",
    "traffic_signal",
    "tree",
    "wall",
]
