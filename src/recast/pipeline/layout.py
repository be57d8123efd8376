"""Names inside a run folder, and the rendering methods that are compared."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from recast.names import folder_name

OBSERVATION_FOLDER = "observation"
EVIDENCE_FILE = "observation/evidence.safetensors"
ACTOR_FOLDER = "actor"
REFINED_FOLDER = "refined"
REFINEMENT_CHECKPOINT = "refinement.safetensors"
TURNTABLE_FILE = "turntable.mp4"
SCENE_FOLDER = "scene"
EVALUATION_FOLDER = "evaluation"
ROLLOUTS_FOLDER = "rollouts"
TRUTH_FOLDER = "truth"
METRICS_FILE = "metrics.json"
REPORT_FOLDER = "report"

Method = Literal["native", "replaced", "oracle"]

METHODS: dict[Method, str] = {
    "native": "native actor",
    "replaced": "replaced actor",
    "oracle": "truth (oracle)",
}
"""Rendering methods in the order of the report, with their names for people."""


def final_actor(run: Path) -> Path:
    """The folder of the actor that a run inserts: the refined one where there is one."""
    refined = run / REFINED_FOLDER
    return refined if refined.is_dir() else run / ACTOR_FOLDER


def rollout_folder(run: Path, motion: str, method: Method) -> Path:
    """Where a rollout of a run lies."""
    return run / ROLLOUTS_FOLDER / folder_name(motion) / method
