"""`recast eval inputs`: what generators that run elsewhere need for a generation study.

OUT/inputs/ID.png             the picture that every model gets: RGBA, alpha on the vehicle
OUT/inputs/perturbed/ID.png   the perturbed one, where perturbations were asked for
OUT/targets.json              the target views of every vehicle: file names and cameras
OUT/study.json                the rows of the paper's table, for `recast eval generation --study`
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PilImage

from recast.evaluation.actor_cases import ActorCase, ActorView
from recast.evaluation.generation_targets import elevation_deg
from recast.evaluation.rounding import rounded
from recast.names import folder_name
from recast.pipeline.generation_maker import perturbed_input
from recast.pipeline.generation_plan import StudySettings, study_cases
from recast.pipeline.generation_results import PERTURBED, view_name
from recast.pipeline.generation_rows import RowRecord, StudyRecord
from recast.recar.picture import Image
from recast.storage import atomic_folder, write_json

INPUTS, TARGETS_FILE, ROWS_FILE = "inputs", "targets.json", "study.json"

PAPER_STUDY = (
    ("real3d", None, "Real3D"),
    ("ln3diff", None, "LN3Diff"),
    ("3dtopia-xl", None, "3DTopia-XL"),
    ("sar3d", None, "SAR3D"),
    ("asset-harvester", None, "Asset Harvester"),
    ("trellis", "./trellis", "TRELLIS"),
    ("stage1", "./stage1", "Stage I only"),
    ("both", "./both", "both stages"),
)
"""Name, source and row of the paper: other generators, and the ablation of the two stages."""


def write_inputs(settings: StudySettings, out: Path) -> list[ActorCase]:
    """Write inputs, target views and a file of rows, whole or not at all.

    Args:
        settings: of the study; its models do not matter.
        out: new folder.

    Returns:
        The vehicles.

    Raises:
        InputError: the set is at fault, `out` exists, or the disk is full.
    """
    cases = study_cases(settings)
    with atomic_folder(out) as partial:
        for case in cases:
            name = f"{folder_name(case.id)}.png"
            _save(case.inputs[0].load(), partial / INPUTS / name)
            if settings.perturbed is not None:
                rgba, _ = perturbed_input(case, settings.seed, settings.perturbed)
                _save(rgba, partial / INPUTS / PERTURBED / name)
        vehicles = [_vehicle(case) for case in cases]
        write_json(partial / TARGETS_FILE, rounded({"version": 1, "vehicles": vehicles}))
        record = StudyRecord(
            seed=settings.seed,
            targets=settings.targets,
            perturbations=settings.perturbed,
            rows=tuple(
                RowRecord(name=name, source=source, published=row)
                for name, source, row in PAPER_STUDY
            ),
        )
        write_json(partial / ROWS_FILE, record.model_dump(mode="json"))
    return cases


def _save(rgba: Image, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    PilImage.fromarray(rgba, "RGBA").save(path, format="PNG")


def _vehicle(case: ActorCase) -> dict[str, Any]:
    name = folder_name(case.id)
    return {
        "id": case.id,
        "files": [f"{name}.ply", f"{name}.glb", f"{name}.obj"],
        "input": f"{INPUTS}/{name}.png",
        "input_azimuth_deg": case.inputs[0].azimuth_deg,
        "input_elevation_deg": elevation_deg(case.inputs[0]),
        "size_m": case.size.tolist(),
        "targets": [_target(name, view) for view in case.targets],
    }


def _target(vehicle: str, view: ActorView) -> dict[str, Any]:
    camera = view.camera
    distance = float(np.linalg.norm(view.camera_from_actor[:3, 3]))
    return {
        "file": f"{vehicle}/{view_name(view.name)}",
        "width": camera.width,
        "height": camera.height,
        "fov_deg": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
        "azimuth_deg": view.azimuth_deg,
        "elevation_deg": elevation_deg(view),
        "distance_m": distance,
        "camera_from_actor": view.camera_from_actor.tolist(),
    }
