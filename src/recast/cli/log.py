"""`recast log`: bring logs in, make them, look at them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro


@dataclass(frozen=True)
class Import:
    """Import a recorded drive into the log folder that everything else reads."""

    importer: tyro.conf.Positional[str]
    """Kind of the dataset: argoverse2 (sensor logs), kitti (raw, synced and rectified), waymo (v1
    TFRecords and motion scenarios); experimental, because they have not met real data: drivestudio
    and street-gaussians (Waymo scenes they processed), nuscenes (JSON tables), py123d (logs it
    converted; needs that package), waymo-v2 (parquet); or an installed importer, or
    package.module:attribute."""
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

        from recast.logs import load_log, write_log
        from recast.parts import IMPORTERS
        from recast.pipeline.display import FrameProgress
        from recast.storage import require_new

        require_new(self.out)
        options: dict[str, Any] = {} if self.refine else {"refine": False}
        console = Console()
        with FrameProgress(console, None, "images and sweeps") as bar:
            log = load_log(
                self.root, importer=self.importer, drive=self.drive, labels=self.labels,
                cameras=self.cameras, **options,
            )  # fmt: skip
            write_log(log, self.out, bar.reach)
        if self.importer in IMPORTERS.experimental:
            told = (
                f"note: {self.importer} is experimental, it has not met real data: look at the log"
            )
            console.print(told, markup=False)
        console.print(f"wrote {self.out}; next: recast log info {self.out}", markup=False)


@dataclass(frozen=True)
class Info:
    """Print sensors, duration, and tracks with the best candidates for replacing first."""

    log: tyro.conf.Positional[str]
    """Log folder, or its address in object storage, such as s3://bucket/folder."""
    json: bool = False
    """Print everything as one JSON object instead, for programs."""

    def __call__(self) -> None:
        """Run the command."""
        import json

        from rich.console import Console

        from recast.logs import load_log, log_info
        from recast.reporting.log_tables import log_info_tables

        info = log_info(load_log(self.log))
        if self.json:
            print(json.dumps(asdict(info), indent=2, allow_nan=False))
            return
        console = Console()
        console.print(*log_info_tables(info, console.width), sep="\n")


@dataclass(frozen=True)
class Synth:
    """Make the log of a synthetic drive, whose true look is known from anywhere."""

    scene: str
    """Name of the street: urban-straight, suburban-curve, signalled-intersection, rural-two-lane,
    arterial-median, parked-street, roundabout-approach, industrial or underpass."""
    out: Path
    """Log folder to write; must not exist."""
    seed: int = 0
    """Seed of all random choices; the same seed gives the same bytes."""
    seconds: float = 8.0
    """Duration, up to 20."""
    width: int = 480
    """Image width in pixels."""
    height: int = 320
    """Image height in pixels."""
    workers: int = 0
    """Number of rendering processes, 0 for one for each core."""
    truth: bool = False
    """Also write exact depth and instance masks, into the folder truth."""
    light: Literal["standard", "mitsuba"] = "standard"
    """Light of the sky: standard, or mitsuba's path tracer (several times the cost; needs the
    extra mitsuba and LLVM)."""
    label_noise: float = 0.0
    """Standard deviation of the error of box positions and sizes, in metres."""
    people: bool = False
    """Also walking pedestrians and riding cyclists."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.display import FrameProgress
        from recast.synthetic import CAMERAS, check_request, make_world, synthesize_log

        console = Console()
        check_request(self.out, self.width, self.height, self.label_noise, light=self.light)
        with console.status(f"building {self.scene}"):
            world = make_world(self.scene, self.seed, self.seconds, self.light, self.people)
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
