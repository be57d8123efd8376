"""Names inside a run folder, and the rendering methods that are compared."""

from __future__ import annotations

OBSERVATION_FOLDER = "observation"
ACTOR_FOLDER = "actor"
TURNTABLE_FILE = "turntable.mp4"
SCENE_FOLDER = "scene"
EVALUATION_FOLDER = "evaluation"
ROLLOUTS_FOLDER = "rollouts"
METRICS_FILE = "metrics.json"
REPORT_FOLDER = "report"

METHODS = {"native": "native actor", "replaced": "replaced actor"}
"""Rendering methods in the order of the report, with their names for people."""
