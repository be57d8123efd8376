"""Vehicle sets of `recast recar`: ingest, camera, perturb and screen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.shared import JSON, console_for, line_of, print_json


@dataclass(frozen=True)
class Ingest:
    """Make a vehicle set from photographs: one folder for each vehicle, and a table."""

    photos: tyro.conf.Positional[Path]
    """Folder with vehicles.csv (or .json) and a folder of photographs for each vehicle."""
    out: Path
    """Set folder; the same command resumes, and a set of the same options grows."""
    licence: str
    """Licence of photographs whose row names no licence."""
    source: str = "photographs"
    """Source of the photographs, in words."""
    table: Annotated[
        Path | None, shared.option("Table of the vehicles.", "vehicles.csv or .json in the folder")
    ] = None
    layout: Literal["regular", "3drealcar", "mad-cars"] = "regular"
    """Layout of the photographs: regular (at regular azimuths), 3drealcar or mad-cars (walk-arounds
    with camera poses; experimental, never run on real data)."""
    views: int = 30
    """Number of views of each vehicle, at regular azimuths."""
    azimuth_within: Annotated[
        float | None,
        shared.option(
            "Maximum azimuth error of a walk-around's photograph in degrees.",
            "half the step between two views",
        ),
    ] = None
    width: int = 1200
    """Width of the set's images in pixels."""
    height: int = 800
    """Height of the set's images in pixels."""
    clockwise: bool = False
    """Read the photographs as clockwise around the vehicle, seen from above."""
    elevation: Annotated[
        float | None,
        shared.option("Measured angle of the camera above the horizontal in degrees.", "unknown"),
    ] = None
    fov: Annotated[
        float | None, shared.option("Measured horizontal field of view in degrees.", "unknown")
    ] = None
    remover: str = "grabcut"
    """Method that removes the background of opaque images: grabcut, a folder with grounding-dino
    and sam, or none."""
    duplicate_bits: int = 20
    """Maximum number of different hash bits (of 255) between two images that count as the
    same."""
    split_seed: int = 0
    """Seed of the split into training and held-out vehicles."""
    held_out: float = 0.05
    """Share of the vehicles that is held out of training (0 to 1)."""
    skip_bad: bool = False
    """Skip faulty vehicles and list them in ingest.json."""
    workers: Annotated[int, shared.WORKERS] = 1

    def __call__(self) -> None:
        from recast.actors.cutout import remover_of
        from recast.core.diagnostics import ProgressBar
        from recast.core.errors import InputError, printable
        from recast.recar.ingest import ingest_photographs
        from recast.recar.ingest_table import IngestSettings

        settings = IngestSettings(
            self.licence,
            self.source,
            self.views,
            self.width,
            self.height,
            self.clockwise,
            self.elevation,
            self.fov,
            self.split_seed,
            self.held_out,
            self.duplicate_bits,
            self.layout,
            self.azimuth_within,
        )
        remover = None if self.remover == "none" else remover_of(self.remover)
        console = console_for(False)
        if self.layout != "regular":
            console.print(
                f"note: {self.layout} is experimental, it has not met real data: look at the set",
                markup=False,
            )

        def show(name: str, error: InputError) -> None:
            line = line_of(error, self)
            console.print(f"{printable(name)}: {line}", markup=False, soft_wrap=True)

        with ProgressBar("pictures", console) as progress:
            report = ingest_photographs(
                self.photos,
                self.out,
                settings,
                remover,
                table=self.table,
                skip_bad=self.skip_bad,
                workers=self.workers,
                progress=progress,
                on_bad=show,
            )
        doubtful = sum(1 for lines in report.doubts.values() if lines)
        console.print(
            f"wrote {self.out}: {len(report.vehicle_set.identities)} identities, "
            f"{len(report.skipped)} left out, {doubtful} to look at, see ingest.json",
            markup=False,
            soft_wrap=True,
        )


@dataclass(frozen=True)
class RecarCamera:
    """Measure the camera of a set from the outlines of its vehicles.

    The photographs must be those of a turntable: one fixed camera, regular azimuths.
    """

    set: tyro.conf.Positional[Path]
    """Vehicle set."""
    out: Annotated[
        Path | None,
        shared.option("Folder of a new set: the same views, centred, with their camera.", "none"),
    ] = None
    fov: Annotated[
        float | None, shared.option("Known horizontal field of view in degrees.", "measured")
    ] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from rich.table import Table

        from recast.cli.rows.results import camera_rows
        from recast.core.errors import InputError, printable
        from recast.recar.turntable import fit_set, medians, write_fitted
        from recast.recar.vehicle_set import read_set

        if self.fov is not None and not 1 <= self.fov <= 170:
            raise InputError("`fov`", "value", f"is {self.fov}", "give 1 to 170")
        vehicle_set = read_set(self.set)
        console = console_for(self.json)
        fits = fit_set(vehicle_set, self.fov)
        elevation, fov = medians(fits)
        rows = camera_rows(vehicle_set, fits)
        if self.json:
            print_json(rows)
        else:
            table = Table("vehicle", "elevation", "fov", "distance_m", "centre px", "residual px")
            for row in rows["cameras"]:
                if row["problem"] is not None:
                    console.print(row["problem"], markup=False, soft_wrap=True)
                    continue
                distance = row["distance_m"]
                table.add_row(
                    printable(row["vehicle"]),
                    f"{row['elevation_deg']:.2f}",
                    f"{row['fov_deg']:.2f}",
                    "unknown size" if distance is None else f"{distance:.3f}",
                    f"{row['centre_x_px']:+.1f}, {row['centre_y_px']:+.1f}",
                    f"{row['residual_px']:.2f}",
                )
            console.print(table)
        console.print(f"medians: --elevation {elevation:.2f} --fov {fov:.2f}", markup=False)
        if self.out is not None:
            write_fitted(vehicle_set, fits, self.out)
            console.print(f"wrote {self.out}", markup=False, soft_wrap=True)


@dataclass(frozen=True)
class Perturb:
    """Draw all perturbations of Stage II on one image, from weak to strong."""

    crop: tyro.conf.Positional[Path]
    """Image of one cut-out vehicle, PNG with alpha."""
    out: Path
    """Image to write (PNG)."""
    config: Annotated[
        Path | None, shared.option("JSON file with changes to the perturbations.", "none")
    ] = None
    write_config: Annotated[
        Path | None, shared.option("JSON file to write the whole configuration to.")
    ] = None
    seed: Annotated[int, shared.SEED] = 0

    def __call__(self) -> None:
        from recast.recar.perturb import (
            PerturbationConfig,
            read_perturbations,
            write_perturbations,
            write_sheet,
        )
        from recast.trellis import read_crop

        config = PerturbationConfig() if self.config is None else read_perturbations(self.config)
        crop = read_crop(self.crop)
        console = console_for(False)
        write_sheet(crop, config, self.seed, self.out)
        console.print(f"wrote {self.out}", markup=False)
        if self.write_config is not None:
            write_perturbations(self.write_config, config)
            console.print(f"wrote {self.write_config}", markup=False)


@dataclass(frozen=True)
class Screen:
    """Write screening.csv and numbered contact sheets of a vehicle set or of its pseudo-targets.

    Write no into the column keep of the vehicles that training is to leave out. The same command
    writes all again and keeps what you wrote.
    """

    set: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SET")]
    """Vehicle set, or cache of pseudo-targets (it may be unfinished)."""

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast.recar import read_set
        from recast.recar.screening import SCREENING_FILE, screened_vehicles, write_screening
        from recast.recar.target_cache import CACHE_FILE, TargetCache
        from recast.recar.targets import screened_targets

        console = console_for(False)
        if (self.set / CACHE_FILE).is_file():
            cache = TargetCache.open(self.set, complete=False)
            known, vehicles = cache.ids(accepted_only=False), screened_targets(cache)
        else:
            vehicle_set = read_set(self.set)
            known, vehicles = tuple(vehicle_set.identities), screened_vehicles(vehicle_set)
        with ProgressBar("vehicles", console) as progress:
            made = write_screening(self.set, known, vehicles, progress)
        console.print(
            f"wrote {self.set / SCREENING_FILE} and {made.sheets} contact sheets: {made.vehicles} "
            f"vehicles, {made.doubted} to look at, {made.decided} decided, "
            f"{made.left_out} left out",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
