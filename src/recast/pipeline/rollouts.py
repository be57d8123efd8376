"""One rollout as a finished folder: states, plans, and a film of every camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast import storage
from recast.errors import InputError
from recast.planning import Planner
from recast.reporting.video import VideoWriter
from recast.simulation import (
    Rollout,
    RolloutFailure,
    RolloutSetup,
    SensorRenderer,
    SimState,
    Timings,
    failure,
    load_rollout,
    run_rollout,
    save_rollout,
)

_FAILURE = "failure.json"
_STATES = "states"


def make_rollout(
    setup: RolloutSetup,
    planner: Planner,
    renderer: SensorRenderer | None,
    folder: Path,
    on_step: Callable[[], None] = lambda: None,
    filmed: bool = True,
    timings: Timings | None = None,
) -> None:
    """Run one rollout and write it to a new folder, whole or not at all.

    A rollout that is refused, or whose planner fails, is written as `failure.json`: a row of the
    report, not the end of the run.

    Args:
        renderer: None where nothing looks: no film, and a planner that needs no images.
        folder: gets `states/` (see `save_rollout`) and `CAMERA.mp4`, or `failure.json`.
        on_step: called after each filmed step.
        filmed: render every step, not only those that the planner sees.
        timings: is added to.
    """
    with storage.atomic_folder(folder) as partial, ExitStack() as films:
        writers: dict[str, VideoWriter] = {}

        def film(state: SimState, images: Mapping[str, NDArray[np.uint8]]) -> None:
            for name, image in images.items():
                if name not in writers:
                    path = partial / f"{name}.mp4"
                    writers[name] = films.enter_context(VideoWriter(path, fps=1 / setup.dt))
                writers[name].add(image)
            on_step()

        try:
            on_frame = film if filmed else None
            rollout = run_rollout(setup, planner, renderer, on_frame, timings)
            save_rollout(rollout, partial / _STATES)
        except Exception as error:
            films.close()
            for name in writers:
                (partial / f"{name}.mp4").unlink(missing_ok=True)
            storage.write_json(partial / _FAILURE, vars(failure(setup, planner.name, error)))


def read_rollout(folder: Path) -> Rollout | RolloutFailure:
    """Read what `make_rollout` wrote.

    Raises:
        InputError: the folder holds neither a rollout nor a failure.
    """
    path = folder / _FAILURE
    if not path.exists():
        return load_rollout(folder / _STATES)
    record = storage.read_json(path)
    try:
        return RolloutFailure(**record)
    except TypeError as error:
        raise InputError(path, "failure", str(error), "run `recast run` again") from None


def films(folder: Path) -> dict[str, Path]:
    """Camera name to film."""
    return {path.stem: path for path in sorted(folder.glob("*.mp4"))}


def write_failure(row: RolloutFailure, folder: Path) -> None:
    """Write why there is no rollout, as a new folder."""
    with storage.atomic_folder(folder) as partial:
        storage.write_json(partial / _FAILURE, vars(row))


def is_failure(folder: Path) -> bool:
    """Whether the folder says why there is no rollout."""
    return (folder / _FAILURE).exists()
