"""What stands beside roads: every function gives a `Surface` that stands on z = 0.

`rng` chooses all that is not given. Impossible sizes, counts and speeds, and unknown styles, kinds
and states raise `InputError`.
"""

from recast.synthetic.scenery.bridges import WALL_STYLES, bridge, guard_rail, wall
from recast.synthetic.scenery.buildings import BUILDING_STYLES, building
from recast.synthetic.scenery.fences import FENCE_STYLES, bush, fence, hedge
from recast.synthetic.scenery.furniture import (
    bench,
    bollard,
    hydrant,
    lamp_post,
    litter_bin,
    parking_meter,
    pole_line,
)
from recast.synthetic.scenery.industry import container, hoarding, pallets
from recast.synthetic.scenery.signs import SIGN_KINDS, SIGNAL_STATES, road_sign, traffic_signal
from recast.synthetic.scenery.trees import TREE_STYLES, tree

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
