"""Names inside of artefacts and of a run folder."""

from __future__ import annotations

STORE_FOLDER = "store"
"""Name of the store beside the run folders, where no other is named."""
LOG_FOLDER = "log"
OBSERVATION_FOLDER = "observation"
EVIDENCE_FILE = "observation/evidence.safetensors"
ACTOR_FOLDER = "actor"
REFINEMENT_CHECKPOINT = "refinement.safetensors"
TURNTABLE_FILE = "turntable.mp4"
VIEWS_FOLDER = "views"
METRICS_FILE = "metrics.json"
REPORT_FOLDER = "report"
REPLAY_FILE = "replay.html"


def use_name(what: str, *names: str) -> str:
    """What a run calls an artefact, such as "scene/recast".

    Args:
        names: names from outside, of tracks, planners, arms and streets; a "/" in one is escaped,
            so that other names never give the same use.
    """
    return "/".join([what, *(name.replace("%", "%25").replace("/", "%2F") for name in names)])


def rollout_name(motion: str, planner: str, arm: str) -> str:
    """What a run calls a rollout."""
    return use_name("rollout", motion, planner, arm)


def use_parts(use: str) -> tuple[str, ...]:
    """What `use_name` was given."""
    return tuple(part.replace("%2F", "/").replace("%25", "%") for part in use.split("/"))
