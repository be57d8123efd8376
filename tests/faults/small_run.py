"""A run that takes no time: a run folder and its store, with artefacts of a few bytes."""

from __future__ import annotations

from pathlib import Path

from recast.core import files
from recast.runs.run_folder import RunFolder, use_name


def small_run(folder: Path) -> Path:
    """Do what `recast run` does with a run folder and its store; give the folder of both."""
    place = str(folder / "store")
    run = RunFolder.create_or_resume(folder / "run", {"seed": 1}, folder / "log", "abc", place)
    store, used = run.store(), {}
    for what, kind, resumes in (
        ("scene", "scenes", True),
        ("actor", "actors", False),
        ("rollout/advancing-a/idm-follower", "rollouts", False),
    ):
        use = use_name(*what.split("/"), "replaced")
        used[use] = store.make(
            kind, {"what": what}, _make_resuming if resumes else _make, name=what, resumes=resumes
        )
        run.refer(store, used)
    run.refer(store, used, whole=True)
    run.finish("metrics.json", "a", lambda: files.write_json(run.path / "metrics.json", {}))
    return folder


def _make(out: Path) -> None:
    with files.atomic_folder(out / "deep") as partial:
        files.write_text(partial / "file.txt", "whole")


def _make_resuming(out: Path) -> None:
    if not (out / "first.txt").exists():
        files.write_text(out / "first.txt", "whole")
    files.write_text(out / "second.txt", "whole")
