"""NeuroNCAP: recast as its renderer, its planners in recast's loop, and its scenarios."""

from __future__ import annotations

TYPE_CHECKING = False  # typing's own costs 5 ms; type checkers know the name
if TYPE_CHECKING:
    from recast_bridges.neuroncap.planner import NeuroNcapPlanner, neuroncap_planner
    from recast_bridges.neuroncap.scenario_file import NcapScenario, read_ncap_scenario
    from recast_bridges.neuroncap.scenario_runs import NcapRun, ncap_runs
    from recast_bridges.neuroncap.scenarios import ImportedFile, import_ncap_scenario
    from recast_bridges.neuroncap.server import ncap_app
    from recast_bridges.neuroncap.service import NcapService

_FILES = {
    "ImportedFile": ".scenarios",
    "NcapRun": ".scenario_runs",
    "NcapScenario": ".scenario_file",
    "NcapService": ".service",
    "NeuroNcapPlanner": ".planner",
    "import_ncap_scenario": ".scenarios",
    "ncap_app": ".server",
    "ncap_runs": ".scenario_runs",
    "neuroncap_planner": ".planner",
    "read_ncap_scenario": ".scenario_file",
}

__all__ = [
    "ImportedFile",
    "NcapRun",
    "NcapScenario",
    "NcapService",
    "NeuroNcapPlanner",
    "import_ncap_scenario",
    "ncap_app",
    "ncap_runs",
    "neuroncap_planner",
    "read_ncap_scenario",
]


def __getattr__(name: str) -> object:
    """A name of `__all__`, imported when it is first used: scenarios need no torch."""
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_FILES[name], __name__), name)
