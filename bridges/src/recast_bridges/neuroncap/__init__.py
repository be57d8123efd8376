"""NeuroNCAP: recast as its renderer, its planners in recast's loop, and its scenarios."""

from __future__ import annotations

from recast.lazy import getattr_of, names_of

TYPE_CHECKING = False  # typing's own costs 5 ms; type checkers know the name
if TYPE_CHECKING:
    from recast_bridges.neuroncap.planner import NeuroNcapPlanner as NeuroNcapPlanner
    from recast_bridges.neuroncap.planner import neuroncap_planner as neuroncap_planner
    from recast_bridges.neuroncap.scenario_file import NcapScenario as NcapScenario
    from recast_bridges.neuroncap.scenario_file import read_ncap_scenario as read_ncap_scenario
    from recast_bridges.neuroncap.scenarios import ImportedFile as ImportedFile
    from recast_bridges.neuroncap.scenarios import NcapRun as NcapRun
    from recast_bridges.neuroncap.scenarios import import_ncap_scenario as import_ncap_scenario
    from recast_bridges.neuroncap.scenarios import ncap_runs as ncap_runs
    from recast_bridges.neuroncap.service import NcapService as NcapService
    from recast_bridges.neuroncap.service import ncap_app as ncap_app

_PLACES = {
    ".planner": ("NeuroNcapPlanner", "neuroncap_planner"),
    ".scenario_file": ("NcapScenario", "read_ncap_scenario"),
    ".scenarios": ("ImportedFile", "NcapRun", "import_ncap_scenario", "ncap_runs"),
    ".service": ("NcapService", "ncap_app"),
}
__all__ = names_of(_PLACES)
__getattr__ = getattr_of(__name__, _PLACES)  # scenarios need no torch
