"""`recast log`: bring logs in, make them, look at them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from recast.errors import InputError


@dataclass(frozen=True)
class Import:
    """Import a recorded drive into the log folder that everything else reads."""

    importer: tyro.conf.Positional[str]
    """Kind of the dataset: argoverse2 (sensor logs), drivestudio and street-gaussians (Waymo scenes
    they processed), kitti (raw, synced and rectified), nuscenes (JSON tables), py123d (logs it
    converted; needs that package), waymo (v1 TFRecords and motion scenarios), waymo-v2 (parquet),
    or an installed importer."""
    root: tyro.conf.Positional[Path]
    """The dataset's folder; for kitti the one that holds the date folder, such as 2011_09_26, for
    argoverse2 the one that holds the splits or the log, for nuscenes the one that holds v1.0-mini
    or v1.0-trainval, for processed scenes the one that holds them, for py123d its data folder, for
    waymo the one that holds the TFRecord files, for waymo-v2 the one that holds vehicle_pose and
    the other components, or the splits."""
    drive: str
    """Name of the drive, such as 2011_09_26_drive_0013; for argoverse2 the log's id, for nuscenes
    the scene's name, such as scene-0061, for processed scenes their folder, such as 002, for waymo
    the segment's name or file, or FILE:SCENARIO, for waymo-v2 and py123d the segment's or log's
    name."""
    out: Path
    """Log folder to write; must not exist."""
    labels: Path | None = None
    """Box labels that lie apart from the drive; for kitti a tracking label file, for argoverse2 an
    annotations file, for processed scenes another track_info.txt or instances_info.json. Without
    it, the drive's own labels are read."""
    cameras: tuple[str, ...] = ()
    """Names of the cameras to import, such as image_02 or CAM_FRONT. Default: all of them; of kitti
    those with colours."""
    refine: bool = True
    """Only for kitti: correct the GPS/IMU poses by matching LiDAR sweeps."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.logs import watch_writing
        from recast.logs.importers import IMPORTERS, LogImporter
        from recast.pipeline.display import FrameProgress

        importer: LogImporter = IMPORTERS.load(self.importer)
        settings = self._settings(importer)
        console = Console()
        with FrameProgress(console, None, "images and sweeps") as bar, watch_writing(bar.reach):
            importer(self.root, self.drive, self.out, self.labels, **settings)
        console.print(f"wrote {self.out}; next: recast log info {self.out}", markup=False)

    def _settings(self, importer: Callable[..., None]) -> dict[str, Any]:
        """The options that were given, if the importer knows them: installed ones may not."""
        given: dict[str, Any] = {}
        if self.cameras:
            given["cameras"] = self.cameras
        if not self.refine:
            given["refine"] = False
        known = inspect.signature(importer).parameters
        for name in given:
            if name not in known:
                option = "--no-refine" if name == "refine" else f"--{name}"
                raise InputError(
                    option, self.importer, "has no such option", "leave the option out"
                )
        return given


@dataclass(frozen=True)
class Info:
    """Print sensors, duration, and tracks with the best candidates for replacing first."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    json: bool = False
    """Print everything as one JSON object instead, for programs."""

    def __call__(self) -> None:
        """Run the command."""
        import json

        from rich.console import Console

        from recast.logs import log_info, read_log
        from recast.reporting.log_tables import log_info_tables

        info = log_info(read_log(self.log))
        if self.json:
            print(json.dumps(asdict(info), indent=2, allow_nan=False))
            return
        console = Console()
        console.print(*log_info_tables(info, console.width), sep="\n")


@dataclass(frozen=True)
class Synth:
    """Make the log of a synthetic drive, whose true look is known from anywhere."""

    scene: str
    """Which street: urban-straight, suburban-curve, signalled-intersection, rural-two-lane,
    arterial-median, parked-street, roundabout-approach, industrial or underpass."""
    out: Path
    """Log folder to write; must not exist."""
    seed: int = 0
    """Decides everything random; the same seed gives the same bytes."""
    seconds: float = 8.0
    """Duration, up to 20."""
    width: int = 480
    """Of the images, pixels."""
    height: int = 320
    """Of the images, pixels."""
    workers: int = 0
    """Processes that render side by side, 0 for one for each core."""
    truth: bool = False
    """Also write exact depth and instance masks, into the folder truth."""
    light: Literal["standard", "mitsuba"] = "standard"
    """Light of the sky: standard, or mitsuba's path tracer (several times the cost; needs the
    extra mitsuba and LLVM)."""
    label_noise: float = 0.0
    """Standard deviation of the boxes' places and sizes, metres."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.display import FrameProgress
        from recast.synthetic import CAMERAS, check_request, make_world, synthesize_log

        console = Console()
        check_request(self.out, self.width, self.height, self.label_noise, light=self.light)
        with console.status(f"building {self.scene}"):
            world = make_world(self.scene, self.seed, self.seconds, self.light)
        frames = (len(CAMERAS) + 1) * (len(world.ego.timestamps_us) - 1)
        with FrameProgress(console, frames, "images and sweeps") as bar:
            synthesize_log(
                world,
                self.out,
                width=self.width,
                height=self.height,
                workers=self.workers,
                truth=self.truth,
                label_noise=self.label_noise,
                progress=bar.reach,
            )
        console.print(
            f"wrote {self.out}, target track {world.target}; next: recast log info {self.out}",
            markup=False,
        )


@dataclass(frozen=True)
class Log:
    """Bring logs in, make them, look at them."""

    command: (
        Annotated[Import, tyro.conf.subcommand("import")]
        | Annotated[Info, tyro.conf.subcommand("info")]
        | Annotated[Synth, tyro.conf.subcommand("synth")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
