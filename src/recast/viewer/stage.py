"""What is shown just now, shared by all windows of a page, and everything in three dimensions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from threading import RLock
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from recast.arrays import Array
from recast.geometry import boxes, se3
from recast.reporting import drawing
from recast.viewer.drives import ViewedDrive, ViewInputs
from recast.viewer.splat_nodes import SplatNodes, drivable_mesh, lane_lines, raised, segments

if TYPE_CHECKING:
    import viser


LAYERS = (
    "splats",
    "sky",
    "boxes",
    "lanes",
    "drivable area",
    "LiDAR",
    "cameras",
    "ego",
    "plans",
    "coverage colours",
)
"""What can be switched on and off."""
_FRUSTUM = 1.0  # metres, height of a camera's image
_LINE = 0.06  # metres


@dataclass(frozen=True)
class Shown:
    """What is looked at: a scenario in an arm, at a step."""

    scenario: str
    arm: str
    step: int


class ViewerStage:
    """The nodes of a viser scene.

    Args:
        most: number of Gaussians of an arm at most.
        arms: arms that are sent at once; the others when they are first shown, or by `splats.add`.
        layers: names of `LAYERS` that are on; None for those that suit the inputs.
        on_click: function that is called with the track id when somebody clicks at its box.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        inputs: ViewInputs,
        most: int,
        arms: Iterable[str],
        layers: set[str] | None = None,
        on_click: Callable[[str], None] | None = None,
    ) -> None:
        self._server, self.inputs, self._on_click = server, inputs, on_click
        self._lock = RLock()
        self._nodes: dict[str, Any] = {}
        self._seen: set[str] = set()
        self._plan: tuple[str, str, int] | None = None
        self._path: tuple[str, str] | None = None
        self._sweep: int | None = None
        self.splats = SplatNodes(server, inputs, most)
        self.splats.add(arms)
        self.layers = set(layers) if layers is not None else self._default_layers()
        self._add_map()

    def show(self, shown: Shown, pictures: bool = True) -> None:
        """Put everything where it is at a step.

        Args:
            pictures: also the images of cameras and the LiDAR, which take longer.
        """
        drive = self.inputs.scenarios[shown.scenario][shown.arm]
        self.splats.add([shown.arm])
        with self._lock, self._server.atomic():
            poses = drive.at(shown.step)
            scene = self.inputs.scenes.get(shown.arm)
            standing = {} if scene is None else scene.standing
            on = self.layers
            seen = self.splats.nodes(
                shown.arm,
                "splats" in on,
                "sky" in on,
                "coverage colours" in on,
                {**standing, **poses},
            )
            seen |= dict.fromkeys(self._map_nodes(scene is None))
            if "boxes" in on:
                seen |= self._boxes(drive, poses)
            if drive.rig is not None:
                seen |= self._ego(drive, shown, drive.rig[shown.step])
                if "cameras" in on:
                    seen |= self._cameras(drive, shown.step, drive.rig[shown.step], pictures)
            if "LiDAR" in on:
                seen |= self._lidar(drive, shown.step, pictures)
            self._apply(seen)
        self._server.flush()

    def _apply(self, seen: Mapping[str, Array | None]) -> None:
        for name in self._seen - set(seen):
            self._node(name).visible = False
        for name, pose in seen.items():
            handle = self._node(name)
            if pose is not None:
                place(handle, pose)
            if name not in self._seen:
                handle.visible = True
        self._seen = set(seen)

    def _node(self, name: str) -> Any:
        return self._nodes[name] if name in self._nodes else self.splats.handles[name]

    def _default_layers(self) -> set[str]:
        on = {"splats", "sky", "boxes", "lanes", "cameras", "ego", "plans"}
        if not self.splats.handles:
            on.add("LiDAR")
        elif not any(drive.controlled for drive in self.inputs.drives):
            on.discard("boxes")  # a recording has many, which hide what was reconstructed
        return on

    def _add_map(self) -> None:
        hdmap, scene = self.inputs.hdmap, self._server.scene
        if hdmap is None:
            return
        boundaries, centrelines = lane_lines(hdmap)
        for name, lines, colour in (
            ("/map/boundaries", boundaries, drawing.BOUNDARY),
            ("/map/centrelines", centrelines, drawing.ROUTE),
        ):
            self._nodes[name] = scene.add_line_segments(
                name, lines.astype(np.float32), colour, thickness=_LINE, visible=False
            )
        vertices, faces = drivable_mesh(hdmap)
        if len(faces):
            self._nodes["/map/drivable"] = scene.add_mesh_simple(
                "/map/drivable",
                vertices.astype(np.float32),
                faces.astype(np.uint32),
                color=drawing.DRIVABLE,
                opacity=0.6,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
                visible=False,
            )

    def _map_nodes(self, bare: bool) -> list[str]:
        """Nodes of the map; `bare`: there is no street, so the road itself is drawn."""
        wanted = []
        if "lanes" in self.layers:
            wanted += ["/map/boundaries", "/map/centrelines"]
        if "drivable area" in self.layers or bare:
            wanted.append("/map/drivable")
        return [name for name in wanted if name in self._nodes]

    def _boxes(self, drive: ViewedDrive, poses: Mapping[str, Array]) -> dict[str, Array | None]:
        names = {}
        for track, pose in poses.items():
            controlled = track in drive.controlled
            names[self._box(track, drive.sizes[track], controlled)] = pose
        return dict(names)

    def _box(self, track: str, size: Array, controlled: bool) -> str:
        name = f"/boxes/{'controlled' if controlled else 'logged'}/{track.encode().hex()}"
        if name in self._nodes:
            return name
        colour = drawing.ACTOR if controlled else drawing.LOGGED
        # Faces would hide the splats within, so only lines are drawn; clicks hit the faces still.
        self._nodes[name] = box = self._server.scene.add_box(
            name,
            colour,
            tuple(size.tolist()),
            wireframe=True,
            opacity=0.02,
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self._outline(f"{name}/edges", size, colour)
        if self._on_click is not None:
            clicked = self._on_click
            box.on_click(lambda _: clicked(track))
        return name

    def _outline(self, name: str, size: Array, colour: drawing.Colour) -> None:
        edges = boxes.corners(size)[np.array(boxes.EDGES)].astype(np.float32)
        self._server.scene.add_line_segments(name, edges, colour, thickness=0.03)

    def _ego(self, drive: ViewedDrive, shown: Shown, rig: Array) -> dict[str, Array | None]:
        seen: dict[str, Array | None] = {}
        if "ego" in self.layers:
            if "/ego/box" not in self._nodes:
                self._nodes["/ego/box"] = self._server.scene.add_frame(
                    "/ego/box", show_axes=False, visible=False
                )
                self._outline("/ego/box/edges", drive.ego_size, drawing.EGO)
            ahead = np.eye(4)
            ahead[:3, 3] = drive.ego_offset, 0.0, drive.ego_size[2] / 2
            seen["/ego/box"] = rig @ ahead
            if self._path != (shown.scenario, shown.arm):
                self._path = shown.scenario, shown.arm
                assert drive.rig is not None
                self._line("/ego/path", raised(drive.rig[:, :3, 3]), drawing.EGO)
                if drive.logged is not None:
                    self._line("/ego/logged", drive.logged, drawing.LOGGED)
            seen["/ego/path"] = None
            if drive.logged is not None:
                seen["/ego/logged"] = None
        made = [number for number, (step, _) in enumerate(drive.plans) if step <= shown.step]
        if "plans" in self.layers and made:
            if self._plan != (shown.scenario, shown.arm, made[-1]):
                self._plan = shown.scenario, shown.arm, made[-1]
                self._line("/ego/plan", drive.plans[made[-1]][1], drawing.PLAN, 0.12)
            seen["/ego/plan"] = None
        return seen

    def _line(
        self, name: str, points: Array, colour: drawing.Colour, thickness: float = _LINE
    ) -> None:
        lines = segments([points]).astype(np.float32)
        if name in self._nodes:
            self._nodes[name].points = lines
        else:
            self._nodes[name] = self._server.scene.add_line_segments(
                name, lines, colour, thickness=thickness, visible=False
            )

    def _cameras(
        self, drive: ViewedDrive, step: int, rig: Array, pictures: bool
    ) -> dict[str, Array | None]:
        seen: dict[str, Array | None] = {}
        for camera, mount in drive.cameras.items():
            name = f"/cameras/{camera.encode().hex()}"
            film = mount.film
            shown = pictures and film is not None and len(film) > 0
            image = film[min(step, len(film) - 1)] if shown and film is not None else None
            if name not in self._nodes:
                self._nodes[name] = self._server.scene.add_camera_frustum(
                    name,
                    mount.fov,
                    mount.aspect,
                    scale=_FRUSTUM,
                    color=drawing.TEXT,
                    image=image,
                    format="jpeg",
                    jpeg_quality=75,
                    cast_shadow=False,
                    receive_shadow=False,
                    visible=False,
                )
            elif pictures and (image is not None or film is None):
                self._nodes[name].image = image
            seen[name] = rig @ mount.rig_from_camera
        return seen

    def _lidar(self, drive: ViewedDrive, step: int, pictures: bool) -> dict[str, Array | None]:
        log, name = self.inputs.log, "/lidar"
        if log is None or not log.lidars:
            return {}
        stream = next(iter(log.lidars.values()))
        if len(stream.timestamps_us) == 0:
            return {}
        index = int(np.abs(stream.timestamps_us - drive.times_us[step]).argmin())
        if pictures and index != self._sweep:
            self._sweep = index
            sweep = stream.sweeps[index]
            points = se3.apply(log.world_from_rig.at(sweep.timestamp_us), sweep.points)
            shade = 90 + 165 * np.sqrt(sweep.intensity.clip(0, 1))
            self._nodes[name] = self._server.scene.add_point_cloud(
                name,
                points.astype(np.float32),
                np.repeat(shade[:, None], 3, axis=1).astype(np.uint8),
                point_size=0.05,
                visible=name in self._seen,
            )
        return {name: None} if name in self._nodes else {}


def place(handle: Any, pose: Array) -> None:
    """Move a node to a pose (4, 4)."""
    handle.position = pose[:3, 3]
    handle.wxyz = se3.matrix_to_quat(pose[:3, :3])


Change = Literal["drive", "step", "playing", "layers"]
"""What changed: scenario or arm, the step, whether it plays, or what is switched on."""


class Playback:
    """Scenario, arm and time, which loops, with those who want to know of changes.

    Args:
        inputs: what there is; scenarios may be added later.

    Attributes:
        speed: seconds of the drive in a second.
        playing: whether time goes on.
        added: scenario, arm and drive of each that was added, in order.
        seconds: present time in the drive that is shown, within [0, steps * dt).
    """

    def __init__(self, inputs: ViewInputs) -> None:
        scenarios = {name: dict(arms) for name, arms in inputs.scenarios.items() if arms}
        self._scenarios = scenarios
        self.inputs = replace(inputs, scenarios=scenarios)
        self._lock = RLock()
        self._listeners: list[Callable[[Change], None]] = []
        self.scenario = next(iter(scenarios))
        self.arm = next(iter(scenarios[self.scenario]))
        self.speed, self.playing, self.seconds = 1.0, False, 0.0
        self.added: list[tuple[str, str, ViewedDrive]] = []

    @property
    def drive(self) -> ViewedDrive:
        """The drive that is shown."""
        return self.inputs.scenarios[self.scenario][self.arm]

    @property
    def step(self) -> int:
        """The step that is shown."""
        with self._lock:
            return min(int(self.seconds / self.drive.dt + 1e-6), len(self.drive) - 1)

    @property
    def shown(self) -> Shown:
        """What is shown."""
        with self._lock:
            return Shown(self.scenario, self.arm, self.step)

    @property
    def arms(self) -> tuple[str, ...]:
        """Arms of the scenario that is shown."""
        return tuple(self._scenarios[self.scenario])

    def subscribe(self, listener: Callable[[Change], None]) -> None:
        """Have a function called after each change."""
        self._listeners.append(listener)

    def select(self, scenario: str | None = None, arm: str | None = None) -> None:
        """Show another scenario or arm, at the same time where it has that.

        An arm that the scenario lacks is replaced by its first one.
        """
        with self._lock:
            scenario = self.scenario if scenario is None else scenario
            arms = self._scenarios[scenario]
            wanted = self.arm if arm is None else arm
            self.scenario, self.arm = scenario, wanted if wanted in arms else next(iter(arms))
            self._stand_at(round(self.seconds / self.drive.dt))
        self._tell("drive")

    def add(self, scenario: str, arm: str, drive: ViewedDrive) -> None:
        """Take a drive in, and show it from its start."""
        with self._lock:
            self._scenarios.setdefault(scenario, {})[arm] = drive
            self.added.append((scenario, arm, drive))
            self.seconds = 0.0
        self.select(scenario, arm)

    def go_to(self, step: int) -> None:
        """Show a step; the nearest one there is."""
        with self._lock:
            self._stand_at(step)
        self._tell("step")

    def by(self, steps: int) -> None:
        """Stop, and go on by some steps, or back if they are negative."""
        with self._lock:
            self.playing = False
            self._stand_at(self.step + steps)
        self._tell("playing")
        self._tell("step")

    def play(self, playing: bool) -> None:
        """Let time go on, or stop it."""
        with self._lock:
            self.playing = playing
        self._tell("playing")

    def refresh(self) -> None:
        """Tell that other things than the step shall be shown."""
        self._tell("layers")

    def tick(self, seconds: float) -> bool:
        """Let time pass; whether another step is shown now."""
        with self._lock:
            if not self.playing:
                return False
            before, span = self.step, len(self.drive) * self.drive.dt
            self.seconds = (self.seconds + seconds * self.speed) % span
            moved = self.step != before
        if moved:
            self._tell("step")
        return moved

    def _stand_at(self, step: int) -> None:
        self.seconds = max(0, min(step, len(self.drive) - 1)) * self.drive.dt

    def _tell(self, change: Change) -> None:
        for listener in tuple(self._listeners):
            listener(change)
