"""The map as planners query it: lanes, blocks, the route, and what may be driven on."""

from recast.planning.map.from_hdmap import planner_map
from recast.planning.map.planner_map import Block, PlannerLane, PlannerMap
from recast.planning.map.route_blocks import continued_route, route_blocks

__all__ = ["Block", "PlannerLane", "PlannerMap", "continued_route", "planner_map", "route_blocks"]
