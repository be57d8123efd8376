"""One scene of a scene-level evaluation: what is asked, its artefacts, tasks and workers."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage

from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera, box_outline
from recast.core import Artefact, Store, files
from recast.core.artefact import Fetch, file_hash, folder_hash
from recast.core.errors import InputError, require_range
from recast.dynamics import EgoState
from recast.dynamics.state import SIZE as EGO_SIZE
from recast.geometry import se3
from recast.metrics.scene_level_images import (
    FEATURES_FILE,
    FRAMES_FILE,
    REFERENCES_FILE,
    FrameRule,
    FramesRecord,
    LoggedFrame,
    Networks,
    ReferencesRecord,
    RolloutFrame,
    SeenImage,
    logged_frames,
    read_frames,
    read_references,
    save_features,
    shown_frames,
    spread_over_azimuth,
    visible_share,
)
from recast.reconstruction.scores import Rectangle
from recast.reconstruction.views import read_view
from recast.runs.arms import Arm
from recast.runs.rollouts import read_rollout
from recast.runs.run_folder import use_name
from recast.runs.sources import RECIPES, vqa_source
from recast.scene import SceneRasterizer, StreetScene, load_scene
from recast.simulation import (
    Rollout,
    RolloutFailure,
    SensorRenderer,
    SimState,
    camera_mounts,
)
from recast.studies.grid import BenchSettings
from recast.studies.scene_run import GridTask, RolloutTimes, SceneOutcome, SceneRun
from recast.studies.schedule import BenchWorker
from recast.synthetic import Oracle, World

Depth = NDArray[np.float32]
DepthOf = Callable[[CameraMount, Array, Rectangle], Depth]
"""Depth (H, W) in metres along z of a street without the target: from a mount, at
`world_from_camera` (4, 4), for points inside of a rectangle at least; inf for the sky."""

LEVEL_FORMAT, LEVEL_VERSION = "recast-scene-level", 1
DRIVER = "pdm-closed"
"""Planner that drives each trajectory once, for all arms (paper, section 5, Q2)."""
LEVEL_MOTIONS = ("cut-in", "oncoming", "stationary", "advancing")
"""The paper's four, with both settings each."""
_FILES = ("inception", "clip", "lpips")
"""Networks that are named by a path."""
_SOLID = 0.5
"""Opacity from which a street hides what lies behind it."""


@dataclass(frozen=True)
class NetworkFiles:
    """Weights of the networks; a score whose network is not given has no column.

    Attributes:
        inception: weights file, see `load_inception`.
        lpips: ImageNet weights of AlexNet or VGG-16, see `load_lpips`.
        vqa: what `load_vqa_scorer` takes as text.
        clip: folder of a CLIP model.
        device: device that the networks compute on: cpu, cuda or cuda:1.
    """

    inception: Path | None = None
    clip: Path | None = None
    lpips: Path | None = None
    vqa: str | None = None
    device: str = "cpu"

    def hashes(self) -> dict[str, str]:
        """What stands for each network that is given, in keys and results.

        Raises:
            InputError: a file is missing, or the VQA scorer is unknown.
        """
        found = {}
        for name in _FILES:
            path = getattr(self, name)
            if path is not None and not path.exists():
                raise InputError(path, name, "is missing", "give a file or folder that exists")
            if path is not None:
                found[name] = folder_hash(path) if path.is_dir() else file_hash(path)
        if self.vqa is not None:
            found["vqa"] = vqa_source(self.vqa)
        return found


@dataclass(frozen=True)
class LevelSettings:
    """A scene-level evaluation.

    Attributes:
        grid: scenes, motions and arms (the first is the baseline); its one planner is `DRIVER`.
        rule, hashes: when an image counts; hashes of the networks' files by name.
        crop: "boxed" keeps the background around the vehicle, "masked" takes away what lies outside
            of the box's outline.
        most_references: logged crops of a scene that LPIPS and the CLIP image score compare with.
        frechet_samples: bootstrap samples of Frechet distances; the other scores' are the grid's.
    """

    grid: BenchSettings
    rule: FrameRule
    crop: Literal["boxed", "masked"]
    most_references: int
    networks: NetworkFiles
    hashes: Mapping[str, str]
    frechet_samples: int

    def __post_init__(self) -> None:
        run = self.grid.run.model_copy(update={"planners": (DRIVER,), "films": False})
        object.__setattr__(self, "grid", replace(self.grid, run=run))

    def absolute(self) -> Self:
        """The same with absolute paths of logs and weights, see `BenchSettings.absolute`."""
        files = {
            name: path.absolute()
            for name in _FILES
            if (path := getattr(self.networks, name)) is not None
        }
        return replace(self, grid=self.grid.absolute(), networks=replace(self.networks, **files))

    def validate(self) -> None:
        """Raise InputError naming the setting at fault."""
        self.rule.validate()
        require_range(1, references=self.most_references, frechet_samples=self.frechet_samples)

    def record(self) -> dict[str, Any]:
        """What makes this evaluation another than others: plain data."""
        return {
            **self.grid.record(),
            "format": LEVEL_FORMAT,
            "version": LEVEL_VERSION,
            "rule": asdict(self.rule),
            "crop": self.crop,
            "most_references": self.most_references,
            "networks": dict(self.hashes),
            "frechet_samples": self.frechet_samples,
        }


def visible_frames(
    rollouts: Sequence[Rollout],
    mounts: Mapping[str, CameraMount],
    rule: FrameRule,
    depths: Sequence[DepthOf],
) -> Iterator[RolloutFrame]:
    """Images that count, by rollout, step and camera: no street hides the vehicle in them.

    Args:
        depths: depth functions of every street that an arm uses.
    """
    for rollout in rollouts:
        size = rollout.actor_size
        for step in range(0, rollout.steps_run, rule.every):
            for name, mount in mounts.items():
                world_from_camera = rollout.world_from_rig[step] @ mount.rig_from_camera
                seen_from = se3.inverse(world_from_camera) @ rollout.world_from_actor[step]
                rectangle = rule.rectangle(size, seen_from, mount.camera)
                if rectangle is None:
                    continue
                shares = (
                    visible_share(
                        depth(mount, world_from_camera, rectangle), size, seen_from, mount.camera
                    )
                    for depth in depths
                )
                if all(share >= rule.least_visible for share in shares):
                    yield RolloutFrame(rollout.motion, rollout.setting, step, name, rectangle)


def street_depth(street: StreetScene, track_id: str) -> DepthOf:
    """Depth of a reconstructed street without a track."""
    others = {key: one for key, one in street.actors.items() if key != track_id}
    rasterizer = SceneRasterizer(replace(street, actors=others))

    def depth(mount: CameraMount, world_from_camera: Array, rectangle: Rectangle) -> Depth:
        del rectangle
        image = rasterizer.render(mount.camera, se3.inverse(world_from_camera), {})
        solid = image.alpha > _SOLID
        return np.where(solid, image.depth / np.where(solid, image.alpha, 1), np.float32(np.inf))

    return depth


def true_depth(world: World, track_id: str) -> DepthOf:
    """Depth of a synthetic world without a track."""
    oracle = Oracle(world)
    underground = np.eye(4)
    underground[2, 3] = -1000.0
    # A parked vehicle is part of the world, so it is put where no ray meets it.
    poses = {track_id: underground} if world.vehicles[track_id].parked else {}

    def depth(mount: CameraMount, world_from_camera: Array, rectangle: Rectangle) -> Depth:
        left, top, right, bottom = rectangle
        window = mount.camera.cropped(left, top, right - left, bottom - top)
        frame = oracle.render(window, world_from_camera, poses)
        return frame.within(mount.camera.width, mount.camera.height, left, top).depth

    return depth


_LOG = logging.getLogger(__name__)
FRAMES, REFERENCES, FEATURES = "frames", "references", "features"
"""Uses of artefacts; those of features have a name behind them."""
REPLAY = "log-replay"
"""Control: the first street with its own vehicle at the logged poses, in the logged images."""


class LevelScene:
    """A scene of the evaluation, `run` with its store; `networks` are loaded once a worker."""

    def __init__(
        self, run: SceneRun, settings: LevelSettings, networks: Callable[[], Networks]
    ) -> None:
        self._settings, self._networks = settings, networks
        self._artefacts, self._maker = run.artefacts, run.artefacts.maker
        self._config, self._source = run.artefacts.config, run.artefacts.source
        self._log, self._track = self._source.log, self._source.log.tracks[self._config.track]
        cameras = self._config.scene.cameras or None
        self._mounts = camera_mounts(self._log, cameras, self._config.scene.scale)

    def prepare(self) -> None:
        """Make streets, vehicles and drives, and find the images that count."""
        for arm in self._artefacts.arms.values():
            if arm.reconstructs:
                self._artefacts.scene(arm)
            if arm.generates:
                self._artefacts.actor(arm, self._config.track)
        self.frames()
        self.references()

    def frames(self) -> Artefact:
        """The images of the drives that count for every arm, see `FrameRule`."""
        drives = {motion: self._drive(motion) for motion in self._config.motions}
        inputs = {
            **self._of_log(),
            "drives": {motion: one.reference for motion, one in drives.items()},
            "streets": self._streets(),
        }

        def make(out: Path) -> None:
            found = self._drives.items()
            rollouts = [one for _, one in found if isinstance(one, Rollout)]
            failures = {m: one.reason for m, one in found if isinstance(one, RolloutFailure)}
            frames = tuple(
                visible_frames(rollouts, self._mounts, self._settings.rule, self._depths())
            )
            record = FramesRecord(frames=frames, shown=shown_frames(frames), failures=failures)
            files.write_json(out / FRAMES_FILE, record.model_dump(mode="json"))

        return self._make(FRAMES, "images that count", inputs, make)

    def references(self) -> Artefact:
        """The logged images that count."""

        def make(out: Path) -> None:
            cameras = [(name, mount.camera) for name, mount in self._mounts.items()]
            frames = list(
                logged_frames(self._log, self._config.track, cameras, self._settings.rule)
            )
            compared = spread_over_azimuth(frames, self._settings.most_references)
            record = ReferencesRecord(frames=tuple(frames), compared=tuple(compared))
            files.write_json(out / REFERENCES_FILE, record.model_dump(mode="json"))

        inputs = {**self._of_log(), "most_references": self._settings.most_references}
        return self._make(REFERENCES, "logged images that count", inputs, make)

    def measured(self, name: str) -> Artefact:
        """What the networks make of the images of an arm, of `REFERENCES` or of `REPLAY`."""
        frames, references = self.frames(), self.references()
        inputs = {
            "references": references.reference,
            "crop": self._settings.crop,
            "networks": dict(self._settings.hashes),
            "recipe": RECIPES["scene-level"],
        }
        arm = self._artefacts.arms.get(name)
        if arm is not None:
            inputs["frames"] = frames.reference
        if name == REPLAY:
            arm = next(one for one in self._artefacts.arms.values() if one.reconstructs)
            arm = Arm.native(arm.street)
            inputs["replayed"] = True
        if arm is not None:
            inputs |= self._artefacts.images_of(arm)
            if arm.generates:
                inputs["actor"] = self._artefacts.actor(arm, self._config.track).reference

        def make(out: Path) -> None:
            logged = read_references(references.path)
            compared = [self._photograph(logged.frames[index]) for index in logged.compared]
            images: Iterator[SeenImage | None]
            if arm is None:
                images = (self._photograph(one) for one in logged.frames)
            elif name == REPLAY:
                images = self._replayed(arm, logged.frames)
            else:
                images = self._driven(arm, read_frames(frames.path), out)
            save_features(self._networks().look(images, compared), out / FEATURES_FILE)

        return self._make(use_name(FEATURES, name), f"features of {name}", inputs, make)

    @cached_property
    def _drives(self) -> dict[str, Rollout | RolloutFailure]:
        """The drives by motion, read once."""
        return {motion: read_rollout(self._drive(motion).path) for motion in self._config.motions}

    def _drive(self, motion: str) -> Artefact:
        """One drive serves all arms: its planner looks at no images."""
        first = next(iter(self._artefacts.arms.values()))
        return self._artefacts.rollout(motion, DRIVER, first)

    def _of_log(self) -> dict[str, Any]:
        """What the images that count depend on besides the drives."""
        return {
            "log": self._source.hash,
            "track": self._config.track,
            "cameras": list(self._mounts),
            "scale": self._config.scene.scale,
            "rule": asdict(self._settings.rule),
            "recipe": RECIPES["scene-level"],
        }

    def _streets(self) -> dict[str, str]:
        """Every street that an arm uses, by name: its artefact, or "truth"."""
        return {
            arm.street: self._artefacts.images_of(arm)["street"]
            for arm in self._artefacts.arms.values()
        }

    def _make(
        self, use: str, title: str, inputs: Mapping[str, Any], make: Callable[[Path], None]
    ) -> Artefact:
        if use not in self._artefacts.used:
            self._artefacts.used[use] = self._maker.make(
                title, "evaluations", inputs, make, f"{title}, {self._log.name}"
            )
        return self._artefacts.used[use]

    def _depths(self) -> list[DepthOf]:
        """Depth of each street that an arm uses."""
        track = self._config.track
        arms = {arm.street: arm for arm in self._artefacts.arms.values()}.values()
        return [
            street_depth(load_scene(self._artefacts.scene(arm).path), track)
            if arm.reconstructs
            else true_depth(self._source.world, track)
            for arm in arms
        ]

    def _seen(
        self, image: Image, rectangle: Rectangle, camera: PinholeCamera, seen_from: Array
    ) -> SeenImage:
        if self._settings.crop == "boxed":
            return SeenImage(image, rectangle)
        outline = np.zeros(image.shape[:2], np.uint8)
        pixels = box_outline(self._track.size, seen_from, camera)
        cv2.fillConvexPoly(outline, cv2.convexHull(np.rint(pixels).astype(np.int32)), 1)
        return SeenImage(image, rectangle, outline > 0)

    def _photograph(self, logged: LoggedFrame) -> SeenImage:
        """A logged image, rectified and resized as renders are."""
        stream, camera = self._log.cameras[logged.camera], self._mounts[logged.camera].camera
        view = read_view(self._log, stream, logged.frame, self._config.scene.scale)
        pose = self._track.trajectory.at(logged.timestamp_us)
        return self._seen(view.image, logged.rectangle, camera, view.camera_from_world @ pose)

    def _replayed(self, arm: Arm, frames: Sequence[LoggedFrame]) -> Iterator[SeenImage | None]:
        """Logged images, drawn from a street with its own vehicle at its logged pose."""
        for one in frames:
            pose = self._track.trajectory.at(one.timestamp_us)
            state = SimState(
                step=one.frame,
                timestamp_us=one.timestamp_us,
                ego=EgoState(np.zeros(EGO_SIZE)),
                log_ego=np.zeros(4),
                world_from_rig=self._log.world_from_rig.at(one.timestamp_us),
                track_id=self._config.track,
                actor=np.zeros(4),
                world_from_actor=pose,
            )
            yield self._drawn(self._renderer(arm), state, one.camera, one.rectangle)

    def _driven(self, arm: Arm, record: FramesRecord, out: Path) -> Iterator[SeenImage | None]:
        """The images of an arm; those of the figure are kept."""
        rollouts = {
            (one.motion, one.setting): one
            for one in self._drives.values()
            if isinstance(one, Rollout)
        }
        for index, one in enumerate(record.frames):
            state = rollouts[one.motion, one.setting].state(one.step)
            found = self._drawn(self._renderer(arm), state, one.camera, one.rectangle)
            if found is not None and index in record.shown:
                PilImage.fromarray(found.image).save(out / shown_file(index), format="PNG")
            yield found

    def _drawn(
        self, renderer: SensorRenderer, state: SimState, camera: str, rectangle: Rectangle
    ) -> SeenImage | None:
        """One image; None, which takes it from all arms, where it cannot be rendered."""
        try:
            image = renderer.render(state, (camera,))[camera]
        except Exception:
            _LOG.warning("step %d, camera %s failed", state.step, camera, exc_info=True)
            return None
        mount = self._mounts[camera]
        world_from_camera = state.world_from_rig @ mount.rig_from_camera
        seen_from = se3.inverse(world_from_camera) @ state.world_from_actor
        return self._seen(image, rectangle, mount.camera, seen_from)

    def _renderer(self, arm: Arm) -> SensorRenderer:
        return self._artefacts.renderers.of(arm, (self._config.track,), LEVEL_FORMAT, self._mounts)


def shown_file(index: int) -> str:
    """Name of the picture of an image that stands in the figure."""
    return f"shown_{index:05d}.png"


@dataclass(frozen=True)
class DriveTask(GridTask):
    """From nothing to a scene's streets, vehicles, drives, and the images that count."""


@dataclass(frozen=True)
class MeasureTask(GridTask):
    """Features of an arm's images, of the logged ones, or of the control's."""

    what: str = ""


class LevelTasks:
    """The tasks that are ready, and what came of them.

    Attributes:
        used: references of artefacts by scene and use.
        failures: error and its reason, by scene, and by the arm where one failed alone.
    """

    def __init__(self, settings: LevelSettings) -> None:
        self._settings = settings
        grid = settings.grid
        self._ready: deque[GridTask] = deque(DriveTask(scene) for scene in grid.scenes)
        self.used: dict[str, dict[str, str]] = {scene.id: {} for scene in grid.scenes}
        self.failures: dict[tuple[str, str], str] = {}
        self.done, self.total = 0, len(grid.scenes) * (1 + len(measured(settings)))

    def take(self) -> GridTask | None:
        """The next task, or None where there is none now."""
        return self._ready.popleft() if self._ready else None

    def note(self, task: GridTask, outcome: SceneOutcome) -> None:
        """A task is done: what it makes possible becomes ready."""
        names = measured(self._settings)
        self.done += 1
        self.used[task.scene.id] |= outcome.used
        if isinstance(task, DriveTask):
            if outcome.error is None:
                self._ready.extend(MeasureTask(task.scene, outcome.log, {}, n) for n in names)
            else:
                self.done += len(names)
        if outcome.error is not None:
            what = task.what if isinstance(task, MeasureTask) else ""
            self.failures[task.scene.id, what] = f"{outcome.error}: {outcome.reason}"

    def needed(self, task: GridTask) -> tuple[str, ...]:
        """References of what the scene of a task has so far, but for features."""
        used = self.used[task.scene.id]
        return tuple(dict.fromkeys(v for use, v in used.items() if not _is_features(use)))


def measured(settings: LevelSettings) -> tuple[str, ...]:
    """What the networks look at in each scene: the arms, the logged images, and the control."""
    arms = settings.grid.run.arms
    control = (REPLAY,) if any(arm.reconstructs for arm in arms) else ()
    return (*(arm.name for arm in arms), REFERENCES, *control)


class LevelWorker(BenchWorker):
    """Does the tasks of a scene-level evaluation, see `BenchWorker`; networks are loaded once."""

    def __init__(self, store: Store, settings: LevelSettings, fetch: Fetch | None) -> None:
        super().__init__(store, settings.grid, False, fetch)
        self._level = settings
        self._loaded: Networks | None = None
        self._opened: tuple[SceneRun, LevelScene] | None = None

    def _do(self, task: GridTask, run: SceneRun) -> RolloutTimes | None:
        if self._opened is None or self._opened[0] is not run:
            self._opened = run, LevelScene(run, self._level, self._networks)
        scene = self._opened[1]
        for use in [use for use in run.artefacts.used if _is_features(use)]:
            del run.artefacts.used[use]  # of the tasks before
        if isinstance(task, MeasureTask):
            scene.measured(task.what)
        else:
            scene.prepare()
        return None

    def _is_new(self, task: GridTask, artefact: Artefact) -> bool:
        return True

    def _networks(self) -> Networks:
        if self._loaded is None:
            self._loaded = Networks(**asdict(self._level.networks))
        return self._loaded


def _is_features(use: str) -> bool:
    return use.startswith(f"{FEATURES}/")
