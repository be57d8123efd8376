"""The page of the documentation that helps with an error.

An `InputError` may name its page. Other errors get the page of the part of recast that raised
them: the innermost function with a page counts.
"""

from __future__ import annotations

import traceback

from recast.errors import InputError

EXTRAS_PAGE = "docs/install.md#extras"

_VEHICLES = "docs/actors.md#bring-your-own-vehicle"
_SCENARIO_FILE = "docs/scenarios.md#your-own-as-a-file"

PAGES = {
    "recast.actors.axes": "docs/actors.md#axes",
    "recast.actors.library": "docs/actors.md#a-library-of-vehicles",
    "recast.actors.mesh": _VEHICLES,
    "recast.actors.ply_generator": _VEHICLES,
    "recast.actors.vehicle_files": _VEHICLES,
    "recast.core": "docs/runs.md#the-store",
    "recast.logs": "docs/data.md#the-log-folder",
    "recast.logs.importers": "docs/data.md#what-can-be-read",
    "recast.pipeline.arms": "docs/runs.md#arms",
    "recast.pipeline.config": "docs/runs.md#a-configuration-file",
    "recast.pipeline.run_folder": "docs/runs.md#the-run-folder",
    "recast.pipeline.show_store": "docs/runs.md#the-store",
    "recast.planning": "docs/planners.md#your-own-planner",
    "recast.planning.registry": "docs/planners.md#built-in",
    "recast.recar": "docs/recar.md",
    "recast.scene.config": "docs/scenes.md#configuration",
    "recast.scene.importers": "docs/scenes.md#scenes-that-others-trained",
    "recast.simulation.scenario": _SCENARIO_FILE,
    "recast.simulation.yaml_lines": _SCENARIO_FILE,
    "recast.splats.cuda": "docs/rasterizer.md#on-a-gpu",
    "recast.synthetic": "docs/synthetic.md",
    "recast.trellis.checkpoints": "docs/image_to_3d.md#model-folders",
    "recast.weights": "docs/weights.md#names",
}
"""Page by module or package; the innermost package counts."""


def page_of(error: InputError) -> str | None:
    """The page to name after the error's line; None if there is none, or the line names one."""
    if error.page is not None or "docs/" in error.mend:
        return error.page
    if "recast-sim[" in error.mend:
        return EXTRAS_PAGE
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        module = frame.f_globals.get("__name__", "") + "."
        matching = (name for name in PAGES if module.startswith(f"{name}."))
        found = max(matching, key=len, default=None)
        if found is not None:
            return PAGES[found]
    return None
