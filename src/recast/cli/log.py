"""`recast log` and `recast scenario`: logs and what may happen on them, before anything runs."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from recast.cli import shared
from recast.cli.shared import JSON, console_for, print_json, without_images


@dataclass(frozen=True)
class Import:
    """Import a recorded drive into a log folder, which all other commands read."""

    importer: tyro.conf.Positional[str]
    """Kind of the dataset: argoverse2 (sensor logs), kitti (raw, synced and rectified), waymo (v1
    TFRecords and motion scenarios); experimental, never run on real data: alpasim (a scene
    bundle), drivestudio and street-gaussians (Waymo scenes they processed), nuscenes (JSON
    tables), py123d (logs it converted; needs the extra py123d), waymo-v2 (parquet); or an
    installed importer, or package.module:attribute."""
    root: tyro.conf.Positional[Path]
    """Folder of the dataset. alpasim: the USDZ file; kitti: the folder with the date folders, such
    as 2011_09_26; argoverse2: with the splits or the log; nuscenes: with v1.0-mini or
    v1.0-trainval; processed scenes: with the scene folders; py123d: its data folder; waymo: with
    the TFRecord files; waymo-v2: with vehicle_pose and the other components, or the splits."""
    out: Path
    """Log folder to write; must not exist."""
    drive: Annotated[
        str | None,
        shared.option(
            "Name of the drive, such as 2011_09_26_drive_0013. alpasim: needs none; argoverse2: id "
            "of the log; nuscenes: name of the scene, such as scene-0061; processed scenes: folder "
            "of the scene, such as 002; waymo: name or file of the segment, or FILE:SCENARIO; "
            "waymo-v2 and py123d: name of the segment or log.",
            metavar="NAME",
        ),
    ] = None
    labels: Annotated[
        Path | None,
        shared.option(
            "File of box labels. kitti: a tracking label file; argoverse2: an annotations file; "
            "processed scenes: a track_info.txt or instances_info.json.",
            "the drive's own labels",
        ),
    ] = None
    cameras: Annotated[
        tuple[str, ...],
        shared.option(
            "Names of the cameras to import, such as image_02 or CAM_FRONT; alpasim: also none.",
            "all; of kitti the colour cameras",
            metavar="NAME [NAME ...]",
        ),
    ] = ()
    refine: bool = True
    """Correct the GPS/IMU poses by matching LiDAR sweeps (kitti only)."""

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast.core.files import require_new
        from recast.core.plugins import IMPORTERS
        from recast.logs import OddLogWarning, load_log, plausibility, write_log

        require_new(self.out)
        options: dict[str, Any] = {} if self.refine else {"refine": False}
        console = console_for(False)
        with ProgressBar("images and sweeps", console) as bar, warnings.catch_warnings():
            warnings.simplefilter("ignore", OddLogWarning)  # printed below
            log = load_log(
                self.root,
                importer=self.importer,
                drive=self.drive,
                labels=self.labels,
                cameras=self.cameras,
                **options,
            )
            write_log(log, self.out, bar)
        empty = [name for name, camera in log.cameras.items() if not len(camera.timestamps_us)]
        for line in without_images(empty):
            console.print(line, markup=False)
        for sentence in plausibility(log).warnings:
            console.print(f"warning: {sentence}", style="bold yellow", markup=False)
        if self.importer in IMPORTERS.experimental:
            told = (
                f"note: {self.importer} is experimental, it has not met real data: look at the log"
            )
            console.print(told, markup=False)
        console.print(f"wrote {self.out}; next: recast log info {self.out}", markup=False)


@dataclass(frozen=True)
class Info:
    """Print the sensors and the tracks of a log, the best candidates for replacing first."""

    log: tyro.conf.Positional[str]
    """Log folder, or its address in object storage, such as s3://bucket/folder."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.cli.rows.logs import log_info_tables
        from recast.logs import OddLogWarning, load_log, log_info

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OddLogWarning)  # printed below
            info = log_info(load_log(self.log))
        if self.json:
            from recast.cli.rows.logs import log_rows

            print_json(log_rows(info))
            return
        console = console_for(False)
        console.print(*log_info_tables(info, console.width), sep="\n")


@dataclass(frozen=True)
class LogSynth:
    """Make the log of a synthetic drive, whose ground truth is known from every viewpoint."""

    scene: str
    """Name of the street: urban-straight, suburban-curve, signalled-intersection, rural-two-lane,
    arterial-median, parked-street, roundabout-approach, industrial or underpass."""
    out: Path
    """Log folder to write; must not exist."""
    seed: Annotated[int, shared.SEED] = 0
    seconds: float = 8.0
    """Duration in seconds, at most 20."""
    width: int = 480
    """Width of the images in pixels."""
    height: int = 320
    """Height of the images in pixels."""
    workers: int = 0
    """Number of rendering processes; 0 uses all cores."""
    truth: bool = False
    """Also write exact depth and instance masks to the folder truth."""
    light: Literal["standard", "mitsuba"] = "standard"
    """Light of the sky: standard, or mitsuba (path tracing at several times the cost; needs the
    extra mitsuba and LLVM)."""
    label_noise: float = 0.0
    """Standard deviation of the noise on box positions and sizes in metres."""
    people: bool = False
    """Add walking pedestrians and cyclists."""
    conditions: Literal[
        "fair", "overcast", "low-sun", "dusk", "underexposed", "overexposed", "varying-exposure"
    ] = "fair"
    """Light of the day, or exposure of the cameras; varying-exposure rises and falls by half a stop
    in 5 s."""

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast.synthetic import CAMERAS, check_request, make_world, synthesize_log

        console = console_for(False)
        check_request(self.out, self.width, self.height, self.label_noise, light=self.light)
        with console.status(f"building {self.scene}"):
            drive = self.scene, self.seed, self.seconds
            world = make_world(*drive, self.light, self.people, self.conditions)
        frames = (len(CAMERAS) + 1) * (len(world.ego.timestamps_us) - 1)
        with ProgressBar("images and sweeps", console, frames) as bar:
            synthesize_log(
                world,
                self.out,
                width=self.width,
                height=self.height,
                workers=self.workers,
                truth=self.truth,
                label_noise=self.label_noise,
                progress=bar,
            )
        console.print(
            f"wrote {self.out}, target track {world.target}; next: recast log info {self.out}",
            markup=False,
        )


Log = shared.group(
    "log",
    "Import, make or inspect logs; recast-bridges exports them.",
    {"import": Import, "info": Info, "synth": LogSynth},
)


@dataclass(frozen=True)
class ScenarioList:
    """Print scenarios with their numbers, or check scenario files."""

    scenarios: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        shared.several("SCENARIO...", "default: all built-in scenarios"),
    ] = ()
    """Scenarios such as cut-in-a, motions such as cut-in, or scenario files (.yaml)."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.cli.rows.logs import list_scenarios, scenario_rows

        if self.json:
            print_json(scenario_rows(self.scenarios))
        else:
            list_scenarios(self.scenarios, console_for(False))


@dataclass(frozen=True)
class ScenarioShow:
    """Draw scenarios on the map of a log: start of the ego, path of the actor, end of the
    rollout."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    motion: Annotated[shared.Names, shared.required(shared.MOTION_HELP)]
    out: Path = Path("scenario.png")
    """Image to write (PNG)."""
    track: Annotated[
        str | None,
        shared.option(shared.TRACK_HELP, "target of a synthetic log, else the first track"),
    ] = None
    steps: Annotated[int, shared.STEPS] = 160
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.cli.rows.logs import place_scenarios, placed_rows, show_scenarios

        placed = place_scenarios(self.log, self.motion, self.track, self.steps)
        show_scenarios(placed, self.out, console_for(self.json))
        if self.json:
            print_json(placed_rows(placed))


Scenario = shared.group(
    "scenario",
    "List scenarios, draw them on a log before a run; recast-bridges exports and imports them.",
    {"list": ScenarioList, "show": ScenarioShow},
)
