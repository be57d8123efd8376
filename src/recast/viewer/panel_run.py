"""Parts of the page about one track: what the log has seen of it, and a new motion to run."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, cast

import numpy as np
import yaml
from numpy.typing import NDArray

from recast.actors import Actor, BoxLidarSegmenter, observe
from recast.arrays import Array, Image
from recast.core import files
from recast.core.errors import InputError
from recast.core.files import folder_name
from recast.dynamics import EgoState
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.reporting import drawing
from recast.simulation import (
    PreparedRollout,
    RolloutSetup,
    ScriptedMotion,
    motion_of_record,
    prepare,
    scenario_record,
)
from recast.simulation.actor_motion import Quantity
from recast.simulation.motions import Stationary
from recast.simulation.scenario import (
    MOTION_SCHEMAS,
    kind_of,
    motion_numbers,
    motion_rows,
    target_motion,
)
from recast.viewer.drives import Runner
from recast.viewer.splat_nodes import raised, segments
from recast.viewer.stage import Playback

if TYPE_CHECKING:
    import viser


VIEWS = 3
"""Most crops of a track."""
_GREY = 128
_FADED = 0.35  # of the crop, beside the vehicle
_MOST_KEPT = 64


@dataclass(frozen=True)
class TrackEvidence:
    """What is known of a track.

    Attributes:
        lines: text for people.
        crops: (H, W, 3) RGB with what is beside the vehicle faded, the best one first, and what
            each of them is.
    """

    lines: tuple[str, ...]
    crops: tuple[tuple[str, Image], ...] = ()


def track_evidence(log: DrivingLog, track_id: str, actor: Actor | None = None) -> TrackEvidence:
    """Gather what a log has seen of a track, and what an actor in its place was made from.

    Args:
        actor: the vehicle that stands in its place; None for none.
    """
    if track_id not in log.tracks:
        return TrackEvidence((f"track {track_id} is not in the log",))
    track = log.tracks[track_id]
    times = track.trajectory.timestamps_us
    length, width, height = track.size.tolist()
    lines = [
        f"{track.category}, {length:.1f} x {width:.1f} x {height:.1f} m, "
        f"labelled for {(times[-1] - times[0]) / 1e6:.1f} s"
    ]
    if actor is not None:
        lines += actor_lines(actor)
    try:
        found = observe(log, track_id, segmenter=BoxLidarSegmenter(), views=VIEWS)
    except InputError as error:
        return TrackEvidence((*lines, f"no view could be cut out: {error.problem}"))
    lines += found.explain().splitlines()
    crops = tuple(
        (f"{one.view.camera}, frame {one.view.frame}", faded(one.rgba)) for one in found.views
    )
    return TrackEvidence(tuple(lines), crops)


def actor_lines(actor: Actor) -> list[str]:
    """Generator of an actor, and the shares of its Gaussians by where they come from."""
    lines = [f"replaced, made by {actor.provenance.generator}"]
    if actor.shares is not None:
        seen, mirrored, invented = actor.shares.columns.mean(dim=0).tolist()
        lines.append(
            f"Gaussians: {seen:.0%} seen, {mirrored:.0%} mirrored, {invented:.0%} invented"
        )
    return lines


def faded(rgba: NDArray[np.uint8]) -> Image:
    """A crop (H, W, 4) as a picture (H, W, 3): what the mask leaves out is nearly grey."""
    alpha = rgba[..., 3:].astype(np.float64) / 255
    share = _FADED + (1 - _FADED) * alpha
    return np.asarray(np.rint(share * rgba[..., :3] + (1 - share) * _GREY), np.uint8)


class TrackPanel:
    """Evidence and crops of the track that was clicked at.

    Args:
        server: server that gets the elements, within the container that is open.
    """

    def __init__(self, server: viser.ViserServer, playback: Playback) -> None:
        self._server, self._playback = server, playback
        self._lock = Lock()
        self._gather = lru_cache(maxsize=_MOST_KEPT)(self._evidence)
        tracks = sorted({track for drive in playback.inputs.drives for track in drive.poses})
        gui = server.gui
        self._tracks = gui.add_dropdown("Track", tuple(tracks) or ("none",))
        self._show = gui.add_button("Show this track in the log")
        self._crops: list[viser.GuiImageHandle] = []
        self._folder = gui.add_folder("Best views in the log")
        self._text = gui.add_markdown("Click on a box, or choose a track.")
        self._show.on_click(lambda _: self.show(self._tracks.value))

    def show(self, track: str) -> None:
        """Tell of a track."""
        with self._lock:
            self._text.content = f"looking at track `{track}` ..."
            found = self._gather(track, self._playback.arm)
            self._text.content = f"**Track `{track}`**\n\n" + "\n".join(
                f"- {escaped(line)}" for line in found.lines
            )
            for crop in self._crops:
                crop.remove()
            with self._folder:
                self._crops = [
                    self._server.gui.add_image(picture, label=label, format="jpeg")
                    for label, picture in found.crops
                ]

    def _evidence(self, track: str, arm: str) -> TrackEvidence:
        inputs = self._playback.inputs
        if inputs.log is None:
            return TrackEvidence(("no log was given: use --log",))
        return track_evidence(inputs.log, track, inputs.actors.get(arm, {}).get(track))


def escaped(line: str) -> str:
    """A line that Markdown shows as it is."""
    return "".join(f"\\{one}" if one in "\\`*_{}[]<>#|~$" else one for one in line)


_LOG = logging.getLogger(__name__)


SETTING = "page"
"""Setting of the motions that are put together on the page."""
_PATH = "/own/path"
_START = "/own/start"
_ANY_LINE = np.array([[[0, 0, 0], [1, 0, 0]]], np.float32)  # without length, a page fails


class RunPanel:
    """A form for a motion, with its path and start in the scene.

    Args:
        server: server that gets the elements, within the container that is open.
        out: folder for scenario files.
    """

    def __init__(
        self, server: viser.ViserServer, playback: Playback, runner: Runner, out: Path
    ) -> None:
        self._server, self._playback, self._runner, self._out = server, playback, runner, out
        self._busy, self._lock = Lock(), Lock()
        self._prepared: PreparedRollout | None = None
        self._inputs: dict[str, viser.GuiTextHandle] = {}
        gui = server.gui
        self._motion = gui.add_dropdown("Motion", tuple(runner.motions))
        self._name = gui.add_text("Name", "my-motion")
        self._planner = gui.add_dropdown("Planner", runner.planners)
        self._edit = gui.add_checkbox("Show and drag the start", False)
        self._run = gui.add_button("Run")
        self._progress = gui.add_progress_bar(0.0, visible=False)
        self._save = gui.add_button("Save as a scenario file")
        self._said = gui.add_markdown("")
        self._folder = gui.add_folder("Numbers")
        self._lines = server.scene.add_line_segments(
            _PATH, _ANY_LINE, drawing.ACTOR, thickness=0.08, visible=False
        )
        self._gizmo = server.scene.add_transform_controls(
            _START,
            scale=3.0,
            active_axes=(True, True, False),
            disable_rotations=True,
            depth_test=False,
            visible=False,
        )
        self._motion.on_update(lambda _: self._load())
        self._edit.on_update(lambda _: self._preview())
        self._run.on_click(lambda _: self._start())
        self._save.on_click(lambda _: self._write())
        self._gizmo.on_update(lambda event: self._drag(event.phase))
        self._load()

    def motion(self) -> ScriptedMotion:
        """What the form describes.

        Raises:
            InputError: a number or the name is wrong.
        """
        base = self._runner.motions[self._motion.value]
        values = {name: _number(name, handle.value) for name, handle in self._inputs.items()}
        return changed(base, self._name.value, values)

    def _load(self) -> None:
        """Put the numbers of the chosen motion into the form."""
        base = self._runner.motions[self._motion.value]
        values = motion_numbers(target_motion(base))
        for handle in self._inputs.values():
            handle.remove()
        self._inputs = {}
        with self._folder:
            for name, quantity in quantities(base).items():
                value = f"{values[name]:g}" if name in values else ""
                label = f"{name} ({quantity.unit})"
                handle = self._server.gui.add_text(label, value, hint=quantity.range)
                handle.on_update(lambda event: self._typed(event))
                self._inputs[name] = handle
        self._preview()

    def _typed(self, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._preview()

    def _preview(self) -> None:
        """Draw where the actor would start and go."""
        shown = self._edit.value
        self._lines.visible = self._gizmo.visible = shown
        if not shown:
            return
        with self._lock:
            try:
                self._prepared = prepared = prepare(self._setup(self.motion()))
            except InputError as error:
                self._prepared = None
                self._say(f"refused: {error.problem}; {error.mend}")
                return
            self._lines.points = segments([raised(prepared.world_from_actor[:, :3, 3])]).astype(
                np.float32
            )
            self._put_start(prepared)
            cut = "" if prepared.cut_reason is None else f" ({prepared.cut_reason})"
            self._say(f"{prepared.steps * 0.1:.1f} s{cut}")

    def _put_start(self, prepared: PreparedRollout) -> None:
        pose = prepared.world_from_actor[0]
        self._gizmo.position = pose[:3, 3]
        self._gizmo.wxyz = se3.matrix_to_quat(se3.rotation_z(se3.yaw(pose))[:3, :3])

    def _drag(self, phase: str) -> None:
        """Turn the place to which the start was dragged into numbers, once it is let go."""
        prepared = self._prepared
        if prepared is None or phase != "end":
            return
        try:
            found = dragged(self.motion(), prepared, np.asarray(self._gizmo.position))
        except InputError as error:
            self._say(str(error))
            return
        for name, value in found.items():
            self._inputs[name].value = f"{value:g}"
        self._preview()

    @property
    def busy(self) -> bool:
        """Whether a rollout is running."""
        return self._busy.locked()

    def _start(self) -> None:
        if not self._busy.acquire(blocking=False):
            self._say("a rollout is running")
            return
        try:
            motion, arm, planner = self.motion(), self._playback.arm, self._planner.value
            self._progress.value, self._progress.visible = 0.0, True
            self._run.disabled = True
            self._say(f"running {motion.name} with {planner} in {arm}")
            drive = self._runner.run(motion, planner, arm, self._count)
            scenario = self._free_name(f"{motion.name}, {planner}")
            self._playback.add(scenario, arm, drive)
            said = ", ".join(e.label for e in drive.events if not e.label.startswith("plan"))
            self._say(f"{scenario}: {(len(drive) - 1) * drive.dt:.1f} s; {said}")
        except InputError as error:
            self._say(f"refused: {error.problem}; {error.mend}")
        except Exception as error:  # of a planner, which may not end the page
            _LOG.warning("rollout from the page failed", exc_info=True)
            self._say(f"failed: {type(error).__name__}: {error}")
        finally:
            self._run.disabled, self._progress.visible = False, False
            self._busy.release()

    def _count(self, done: int, total: int) -> None:
        self._progress.value = 100.0 * done / max(total, 1)

    def _free_name(self, name: str) -> str:
        there = self._playback.inputs.scenarios
        numbered = (name if n == 1 else f"{name} ({n})" for n in range(1, len(there) + 2))
        return next(one for one in numbered if one not in there)

    def _write(self) -> None:
        try:
            path = save_scenario(self.motion(), self._out)
        except InputError as error:
            self._say(f"not saved: {error}")
            return
        self._say(f"saved {path}; recast run LOG --motion {path} runs it")

    def _setup(self, motion: ScriptedMotion) -> RolloutSetup:
        runner = self._runner
        return RolloutSetup(runner.log, runner.track, motion, map=runner.hdmap, steps=runner.steps)

    def _say(self, text: str) -> None:
        self._said.content = escaped(text)


def _number(name: str, text: str) -> float | None:
    if not text.strip():
        return None
    try:
        return float(text)
    except ValueError:
        raise InputError("page", name, f"is {text!r}", "give a number") from None


def quantities(motion: ScriptedMotion) -> Mapping[str, Quantity]:
    """The numbers that can be set of what the target does, by name."""
    kind = kind_of(target_motion(motion))
    return {} if kind is None else MOTION_SCHEMAS[kind].quantities


def changed(
    motion: ScriptedMotion, name: str, values: Mapping[str, float | None]
) -> ScriptedMotion:
    """What the target does, under another name and with other numbers; without further actors.

    Args:
        values: numbers by quantity; None leaves an optional one out.

    Raises:
        InputError: a name or number that no scenario file may have.
    """
    target = target_motion(motion)
    kept = {key: float(value) for key, value in values.items() if value is not None}
    record = {
        **scenario_record(cast(ScriptedMotion, target)),
        "name": name,
        "settings": {SETTING: {**kept, **motion_rows(target)}},
    }
    return motion_of_record(record, "page")


def dragged(motion: ScriptedMotion, prepared: PreparedRollout, place: Array) -> dict[str, float]:
    """The numbers that put the target where somebody dragged it, as far as it has them.

    Args:
        motion: what the target does now.
        prepared: the rollout of that motion.
        place: (>=2,) where its centre shall start, world metres.

    Returns:
        "gap" or "min_gap", and "lateral", within their ranges and to the centimetre.
    """
    (s, s_new), (lateral, lateral_new) = prepared.route.project(
        np.stack([prepared.actor[0, :2], place[:2]])
    )
    target = target_motion(motion)
    values = motion_numbers(target)
    if isinstance(target, Stationary):  # which may stand further away than its least gap
        speed = float(EgoState(prepared.ego).vx)
        values["min_gap"] = max(target.min_gap, speed**2 / target.braking + target.reserve)
    moved = {"gap": s_new - s, "min_gap": s_new - s, "lateral": lateral_new - lateral}
    found = {}
    for name, by in moved.items():
        known = quantities(motion).get(name)
        if known is not None and name in values:
            value = min(max(values[name] + float(by), known.low), known.high)
            found[name] = round(value, 2)
    return found


def save_scenario(motion: ScriptedMotion, folder: Path) -> Path:
    """Write a scenario file for `recast run --motion`, and return its path.

    Args:
        folder: folder of the file, whose name is made from the motion's and leads nowhere else.

    Raises:
        InputError: the motion is none that a file can describe, the file exists, or the disk
            refuses.
    """
    text = yaml.safe_dump(scenario_record(motion), sort_keys=False, allow_unicode=True)
    path = Path(folder) / f"{folder_name(motion.name)}.yaml"
    if path.exists():
        raise InputError(path, "file", "exists already", "give the motion another name")
    with files.disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    files.write_text(path, text)
    return path
