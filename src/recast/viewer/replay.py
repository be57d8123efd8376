"""A replay: one HTML file with the moving scene, which needs neither a server nor the network."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from recast.core import files
from recast.core.errors import InputError
from recast.viewer.inputs import ViewInputs
from recast.viewer.page import LOOPBACK, MOST_GAUSSIANS, close_server, open_server
from recast.viewer.panel_play import open_at, overview
from recast.viewer.stage import Shown, ViewerStage

REPLAY_MB = 15.0
"""Default size of a replay at most, in 1e6 bytes."""
_PAUSE = 1.0  # seconds at the end of each arm
_PICTURES_EVERY = 5  # steps
_TRIES = 6
_MARGIN = 0.95
_PAGE = 900_000  # bytes of a replay without a scene
_GAUSSIAN = 36  # bytes, at least: 28 in base 64, of which zstd saves little


@dataclass(frozen=True)
class ReplaySize:
    """What a replay came to.

    Attributes:
        bytes: size of the file in bytes.
        kept: number of Gaussians in the file.
        total: number of Gaussians that there were.
    """

    bytes: int
    kept: int
    total: int


def write_replay(
    inputs: ViewInputs,
    path: str | Path,
    *,
    scenario: str | None = None,
    most_mb: float = REPLAY_MB,
    most: int = MOST_GAUSSIANS,
) -> ReplaySize:
    """Write the drive of one scenario as an HTML file that plays by itself, arm after arm.

    Arms without Gaussians are left out if others have some.

    The number of Gaussians is lowered until the file is small enough. While it works, it holds a
    port of this machine that only this machine reaches.

    Args:
        path: file to write; one that is there is replaced.
        scenario: name of the scenario; None for the first.
        most_mb: largest size of the file, in 1e6 bytes.
        most: largest number of Gaussians.

    Raises:
        InputError: viser is not installed, there is no such scenario, the file would be too large
            even without Gaussians, or the disk refuses.
    """
    name = next(iter(inputs.scenarios)) if scenario is None else scenario
    if name not in inputs.scenarios:
        raise InputError(
            "replay",
            f"scenario {name}",
            "is not in the run",
            f"choose one of {', '.join(inputs.scenarios)}",
        )
    limit = round(most_mb * 1e6)
    most = min(most, max(limit - _PAGE, 0) // _GAUSSIAN)  # what surely does not fit is not tried
    shown = _only(inputs, name)
    for _ in range(_TRIES):
        html, kept, total = _recorded(shown, name, most)
        size = len(html.encode())
        if size <= limit or kept == 0:
            break
        most = round(kept * max(limit - _PAGE, 0) / max(size - _PAGE, 1) * _MARGIN)
    if size > limit:
        raise InputError(
            "replay",
            "size",
            f"is at least {size / 1e6:.1f} MB",
            f"set `replay_mb` above {most_mb:g}",
        )
    files.write_text(Path(path), html)
    return ReplaySize(size, kept, total)


def _only(inputs: ViewInputs, scenario: str) -> ViewInputs:
    """One scenario, with the arms that have Gaussians; without what only a page can show."""
    drives = inputs.scenarios[scenario]
    drawn = {arm: drive for arm, drive in drives.items() if inputs.scenes.get(arm) is not None}
    drives = drawn or drives
    scenes = {arm: inputs.scenes.get(arm) for arm in drives}
    return replace(inputs, scenes=scenes, scenarios={scenario: drives}, actors={}, runner=None)


def _recorded(inputs: ViewInputs, scenario: str, most: int) -> tuple[str, int, int]:
    """The page, and how many Gaussians it has of how many."""
    server = open_server(LOOPBACK, 8099)
    try:
        stage = ViewerStage(server, inputs, most, inputs.scenes)
        drives = inputs.scenarios[scenario]
        open_at(server, overview(next(iter(drives.values()))))
        first = next(iter(drives))
        stage.show(Shown(scenario, first, 0))
        recording = server.get_scene_serializer()
        for arm, drive in drives.items():
            if drive.rig is not None and len(drives) > 1:  # the label rides on the ego
                server.scene.add_label("/ego/box/arm", arm, position=(0.0, 0.0, 2.0))
            for step in range(len(drive)):
                stage.show(Shown(scenario, arm, step), step % _PICTURES_EVERY == 0)
                recording.insert_sleep(drive.dt)
            recording.insert_sleep(_PAUSE)
        return recording.as_html(dark_mode=True), stage.splats.kept, stage.splats.total
    finally:
        close_server(server)
