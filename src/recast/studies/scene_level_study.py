"""`recast bench scene-level`, from scenes to the paper's table of rendering quality, and figures.

docs/scene_level.md lists the files that it writes.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from PIL import Image as PilImage
from rich.console import Console
from rich.table import Table
from rich.text import Text

from recast.arrays import Image
from recast.core import Store, files
from recast.core.diagnostics import ProgressBar
from recast.core.errors import printable
from recast.core.files import folder_name
from recast.core.images import decode_image, draw_text, rgb
from recast.metrics.scene_level_images import (
    COLUMNS,
    FEATURES_FILE,
    Features,
    Networks,
    RolloutFrame,
    load_features,
    read_frames,
    read_references,
)
from recast.metrics.scene_level_table import (
    LevelRow,
    MeasuredScene,
    cell,
    results_json,
    summarise,
    table_markdown,
    warnings,
    write_images,
)
from recast.reporting.drawing import at_width
from recast.runs.display import narrow_table
from recast.runs.run_folder import use_name
from recast.studies.closed_loop import broken_name, check_grid
from recast.studies.grid import RESULTS_FILE, begin
from recast.studies.scene_level_tasks import (
    FEATURES,
    FRAMES,
    REFERENCES,
    REPLAY,
    LevelSettings,
    LevelTasks,
    LevelWorker,
    measured,
    shown_file,
)
from recast.studies.scene_run import GridTask, SceneOutcome
from recast.studies.schedule import Workers

MOST_ROWS = 8
_WIDTH, _HEAD, _GAP = 360, 18, 4
IMAGES_FILE, TABLE_FILE = "scene_level.parquet", "table.md"


def run_scene_level(
    settings: LevelSettings,
    out: Path,
    console: Console,
    *,
    workers: int = 1,
    ray: str | None = None,
    store: str | Path | None = None,
) -> list[LevelRow]:
    """Drive, render, measure, and write and print the table.

    A scene that fails, or has an arm that fails, is left out for all arms and listed. What a killed
    command finished stays; all files are the same bytes for any number of workers.

    Args:
        out: folder that is new, empty, or of this very evaluation.
        workers, ray, store: see `recast.studies.run_closed_loop`.

    Raises:
        InputError: bad settings, another evaluation in `out`, no scene that counts, or a worker was
            killed.
    """
    settings.validate()
    team = Workers(out, workers, ray, store)
    check_grid(settings.grid)
    # Wrong weights end here, not after the first street; the VQA scorer's are too large for that.
    Networks(**asdict(replace(settings.networks, vqa=None, device="cpu")))
    record = settings.record()
    begin(out, record)
    if ray is not None:
        settings = settings.absolute()
    tasks = LevelTasks(settings)

    def done(task: GridTask, outcome: SceneOutcome) -> None:
        tasks.note(task, outcome)
        bar(tasks.done, tasks.total)

    with files.alone_in(out):
        with ProgressBar("scenes and arms", console, tasks.total) as bar:
            team.do(LevelWorker, (settings,), settings.grid, tasks, done)
        failures = {
            (scene if not what else f"{scene}, {what}"): reason
            for (scene, what), reason in sorted(tasks.failures.items())
        }
        found = _Found(settings, tasks, team.store)
        scenes = found.scenes(failures)
        for where, reason in failures.items():
            line = printable(f"{where}: {reason}")
            console.print(line, markup=False, highlight=False, style="red")
        rows = summarise(
            scenes, REPLAY, settings.grid.samples, settings.frechet_samples, settings.grid.run.seed
        )
        warned = warnings(rows, scenes)
        notes = [*warned, *(f"{where}: {why}" for where, why in failures.items())]
        write_images(scenes, out / IMAGES_FILE)
        for scene in scenes:
            for name in measured(settings):
                found.copy(scene, name, out)
        write_figures(
            {name: scene.frames for name, scene in scenes.items()},
            [arm.name for arm in settings.grid.run.arms],
            found.shown,
            out,
        )
        files.write_json(out / RESULTS_FILE, results_json(rows, scenes, failures, record))
        files.write_text(out / TABLE_FILE, table_markdown(rows, notes))
    for name in (name for name in COLUMNS if any(name in row.values for row in rows)):
        console.print(_table(name, rows))
    for note in warned:
        console.print(note, markup=False, highlight=False, style="yellow")
    console.print(f"wrote {out}", markup=False)
    return rows


class _Found:
    """What the workers made, read from the store."""

    def __init__(self, settings: LevelSettings, tasks: LevelTasks, store: Store) -> None:
        self._settings, self._tasks, self._store = settings, tasks, store
        self._arms = [arm.name for arm in settings.grid.run.arms]

    def scenes(self, failures: dict[str, str]) -> dict[str, MeasuredScene]:
        """The scenes that count; why others do not joins `failures`."""
        found = {}
        for scene in (one.id for one in self._settings.grid.scenes):
            if any(name == scene for name, _ in self._tasks.failures):
                continue
            frames, logged = self._path(scene, FRAMES), self._path(scene, REFERENCES)
            record, references = read_frames(frames), read_references(logged)
            failures |= {f"{scene}, {motion}": why for motion, why in record.failures.items()}
            replayed = REPLAY in measured(self._settings)
            one = MeasuredScene(
                frames=record.frames,
                logged=references.frames,
                compared=references.compared,
                arms={arm: self._features(scene, arm) for arm in self._arms},
                references=self._features(scene, REFERENCES),
                replay=self._features(scene, REPLAY) if replayed else None,
            )
            problem = one.problem()
            if problem is None:
                found[scene] = one
                for index in np.flatnonzero(~one.drawn()).tolist():
                    lost = record.frames[index]
                    where = f"{lost.motion}-{lost.setting} step {lost.step} {lost.camera}"
                    failures[f"{scene}, {where}"] = "could not be rendered for every arm"
            else:
                failures[scene] = problem
        return found

    def copy(self, scene: str, name: str, out: Path) -> None:
        """Put the features of an arm, or of the logged images, where users look for them."""
        target = out / FEATURES / folder_name(name) / f"{scene}.npz"
        path = self._path(scene, use_name(FEATURES, name)) / FEATURES_FILE
        with files.atomic_file(target) as partial:
            shutil.copyfile(path, partial)

    def shown(self, scene: str, arm: str) -> dict[int, Path]:
        """Pictures of the images that stand in the figure, by number of the image."""
        folder = self._path(scene, use_name(FEATURES, arm))
        paths = {i: folder / shown_file(i) for i in read_frames(self._path(scene, FRAMES)).shown}
        return {index: path for index, path in paths.items() if path.is_file()}

    def _features(self, scene: str, name: str) -> Features:
        return load_features(self._path(scene, use_name(FEATURES, name)) / FEATURES_FILE)

    def _path(self, scene: str, use: str) -> Path:
        return self._store.open(self._tasks.used[scene][use]).path


def _table(name: str, rows: Sequence[LevelRow]) -> Table:
    """One column of the table with intervals and differences, 80 characters wide."""
    column = COLUMNS[name]
    better = "higher" if column.higher_is_better else "lower"
    figures = ("images", "value", "95 % over scenes", f"minus {rows[0].arm}")
    table = narrow_table(f"{column.heading}, {better} is better", ["arm"], figures)
    for row in rows:
        cells = [*cell(name, row.values.get(name)).split("\n"), "", "", ""][:3]
        table.add_row(Text(broken_name(printable(row.arm))), str(row.images), *cells)
    return table


def write_figures(
    frames: Mapping[str, Sequence[RolloutFrame]],
    arms: Sequence[str],
    pictures: Callable[[str, str], Mapping[int, Path]],
    out: Path,
) -> None:
    """Write a figure for each motion: a row for each scene and setting, a column for each arm.

    Args:
        pictures: function from scene and arm to picture files by number of the image.
    """
    motions = dict.fromkeys(frame.motion for scene in frames.values() for frame in scene)
    shown = {scene: {arm: pictures(scene, arm) for arm in arms} for scene in frames}
    for motion in motions:
        rows = [
            (
                f"{scene}, {frames[scene][index].setting}, step {frames[scene][index].step}",
                [of_arm.get(index) for of_arm in by_arm.values()],
            )
            for scene, by_arm in shown.items()
            for index in next(iter(by_arm.values()), {})
            if frames[scene][index].motion == motion
        ]
        if rows:
            figure = _figure(rows[:MOST_ROWS], arms)
            with files.atomic_file(out / f"figure_{folder_name(motion)}.png") as partial:
                figure.save(partial, format="PNG")


def _figure(
    rows: Sequence[tuple[str, Sequence[Path | None]]], arms: Sequence[str]
) -> PilImage.Image:
    cells = [[_cell(path) for path in paths] for _, paths in rows]
    heights = [_HEAD + max(len(cell) for cell in row) for row in cells]
    size = ((_WIDTH + _GAP) * len(arms) - _GAP, _HEAD + sum(heights) + _GAP * len(rows))
    figure = np.full((size[1], size[0], 3), 255, np.uint8)
    for column, arm in enumerate(arms):
        draw_text(figure, (column * (_WIDTH + _GAP) + 2, 3), arm, size=10)
    top = _HEAD
    for (title, _), row, height in zip(rows, cells, heights, strict=True):
        draw_text(figure, (2, top + 3), title, size=10)
        for column, picture in enumerate(row):
            left, high, wide = column * (_WIDTH + _GAP), *picture.shape[:2]
            figure[top + _HEAD : top + _HEAD + high, left : left + wide] = picture
        top += height + _GAP
    return PilImage.fromarray(figure)


def _cell(path: Path | None) -> Image:
    if path is None:
        return np.full((_WIDTH * 2 // 3, _WIDTH, 3), 200, np.uint8)
    return at_width(rgb(decode_image(path, path)), _WIDTH)
