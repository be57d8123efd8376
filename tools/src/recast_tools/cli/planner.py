"""`recast planner dataset | train | export | probe`: the small planner's recipe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import tyro

from recast.cli import shared
from recast.cli.shared import JSON, Rows, console_for, print_json

if TYPE_CHECKING:
    from recast_tools.planner_probe import ProbeRow


# As in `recast_tools.planner_training.samples`, which imports more than help needs.
_DriveKind = Literal[
    "ordinary",
    "leading",
    "stationary",
    "oncoming",
    "through",
    "cut-in",
    "advancing",
    "crossing",
    "along",
]
_Renderer = Literal["oracle", "native", "replaced", "refined"]


@dataclass(frozen=True)
class Dataset:
    """Render and score training samples in synthetic worlds; the same command resumes."""

    out: Path
    """Folder of the samples; a folder of the same settings grows."""
    samples: int = 8000
    """Minimum number of samples; worlds are made whole."""
    driver: Annotated[
        Path | None,
        shared.option(
            "Folder of the planner that drives every second drive, or one of the package, such as "
            "gtrs-mini: the samples show what it comes to.",
            "an expert that knows the scores drives all",
        ),
    ] = None
    seed: Annotated[int, shared.SEED] = 0
    per_world: int = 32
    """Number of samples of each world."""
    reconstructed: float = 0.0
    """Share of the worlds that are shown by a reconstructed street instead of the oracle, with the
    target as reconstructed, replaced, and replaced and refined (0 to 1)."""
    renderers: tuple[_Renderer, ...] = get_args(_Renderer)[1:]
    """What shows the drives in reconstructed worlds, in turn."""
    street_steps: int = 1000
    """Number of training steps of each reconstructed street."""
    kinds: tuple[_DriveKind, ...] = get_args(_DriveKind)
    """What happens in the drives; without the others, these keep their proportions."""
    store: Annotated[
        str | None, shared.option(shared.STORE_HELP, "store/ beside the folder of the samples")
    ] = None
    workers: Annotated[int, shared.WORKERS] = 1

    def __call__(self) -> None:
        from pydantic import ValidationError

        from recast.core.diagnostics import ProgressBar
        from recast.core.records import validation_error
        from recast.planning.gtrs.planner import CONFIG_FILE, WEIGHTS_FILE
        from recast.recar.training import hash_files
        from recast.synthetic import SCENES
        from recast.weights import located
        from recast_tools.planner_data.dataset import make_dataset
        from recast_tools.planner_training.samples import DatasetRecord, SampleStore

        console = console_for(False)
        driver = located("--driver", self.driver)
        try:
            record = DatasetRecord(
                seed=self.seed,
                per_world=self.per_world,
                scenes=SCENES,
                reconstructed=self.reconstructed,
                street_steps=self.street_steps,
                renderers=self.renderers,
                kinds=self.kinds,
                driver=""
                if driver is None
                else hash_files(driver, [driver / WEIGHTS_FILE, driver / CONFIG_FILE]),
            )
        except ValidationError as error:
            raise validation_error("options", error, "give a value in range") from None
        with ProgressBar("samples", console) as progress:
            made = make_dataset(
                self.out,
                self.samples,
                record,
                driver=driver,
                store=self.store,
                workers=self.workers,
                progress=progress,
            )
        console.print(f"wrote {self.out}: {made} samples", markup=False)
        if self.reconstructed:
            counts = SampleStore(self.out).by_renderer()
            said = ", ".join(f"{count} {name}" for name, count in counts.items())
            console.print(f"images: {said}", markup=False, highlight=False)


@dataclass(frozen=True)
class PlannerShow:
    """Draw samples of a dataset: their images, and their best trajectories from above."""

    dataset: tyro.conf.Positional[Path]
    """Folder of `recast planner dataset`."""
    out: Path
    """Image to write (PNG)."""
    count: int = 12
    """Number of samples."""
    first: int = 0
    """Index of the first sample."""

    def __call__(self) -> None:
        from recast.core.files import write_bytes
        from recast.logs.images import encode
        from recast_tools.planner_training.evaluate import truth_sheet
        from recast_tools.planner_training.samples import SampleStore

        sheet = truth_sheet(SampleStore(self.dataset), self.first, self.count)
        write_bytes(self.out, encode(sheet))


@dataclass(frozen=True)
class PlannerTrain:
    """Train the small planner on samples; the same command resumes, with the same result."""

    dataset: Annotated[
        tyro.conf.UseAppendAction[tuple[Path, ...]],
        shared.option(
            "Folder of `recast planner dataset`. May be repeated. Every tenth world is held out."
        ),
    ]
    out: Path
    """Folder of the training."""
    config: Annotated[
        Path | None,
        shared.option(
            'JSON file with changes to the training, such as {"trainer": {"steps": 4000}}.',
            "the shipped planner's training",
        ),
    ] = None
    start: Annotated[
        Path | None,
        shared.option(
            "Planner folder with the initial weights, or one of the package, such as gtrs-mini; "
            "its network must have the same sizes.",
            "random weights",
        ),
    ] = None
    seed: Annotated[int, shared.SEED] = 0
    steps: Annotated[
        int | None, shared.option("Number of optimiser steps.", "the shipped planner's")
    ] = None
    renderers: Annotated[
        tuple[_Renderer, ...] | None,
        shared.option("Leave out the samples that others have rendered.", "all"),
    ] = None
    threads: int = 1
    """Number of CPU threads; the result depends on it in the last digits."""

    def __call__(self) -> None:
        import torch

        from recast.weights import located
        from recast_tools.planner_training.task import chosen_training
        from recast_tools.planner_training.train import train_planner

        torch.set_num_threads(self.threads)
        console = console_for(False)
        config = chosen_training(self.config, self.seed, self.steps, self.renderers)
        start = located("--start", self.start)
        reached = train_planner(self.dataset, self.out, config, console, start)
        for name, value in reached.means().items():
            console.print(f"{name}: {value:.4g}", highlight=False)
        console.print(f"wrote {self.out}; next: recast planner export {self.out}", markup=False)


@dataclass(frozen=True)
class PlannerExport:
    """Write a trained planner as a folder that `--planner` takes."""

    training: tyro.conf.Positional[Path]
    """Folder of `recast planner train`; the training may be unfinished."""
    dataset: Annotated[
        tyro.conf.UseAppendAction[tuple[Path, ...]],
        shared.option(
            "Folder of `recast planner dataset`; those of the training, in the same order."
        ),
    ]
    out: Path
    """Folder to write; must not exist."""
    mean_with: Annotated[
        Path | None,
        shared.option(
            "Planner folder, such as the one that the training began with: the weights written are "
            "the mean of its and the training's.",
            "the training's weights alone",
        ),
    ] = None
    share: float = 0.5
    """Share that the weights of `mean_with` have in the mean (0 to 1)."""

    def __call__(self) -> None:
        from recast_tools.planner_training.train import export_planner

        export_planner(self.training, self.dataset, self.out, self.mean_with, self.share)
        size = sum(path.stat().st_size for path in self.out.iterdir())
        console_for(False).print(f"wrote {self.out}: {size / 1e6:.1f} MB", markup=False)


@dataclass(frozen=True)
class Probe:
    """Test whether a planner uses its images: drive with the target visible, and with it erased."""

    planner: tyro.conf.Positional[str]
    """Planner that reads images: a name, or a folder of `recast planner export`."""
    out: Path
    """Folder of the rollouts; finished rollouts of the same planner are reused."""
    scene: Annotated[
        shared.Names,
        shared.option("Synthetic scene. May be repeated.", "all scenes"),
    ] = ()
    motion: Annotated[
        shared.Names,
        shared.option(shared.MOTION_HELP, "stationary, oncoming and cut-in"),
    ] = ()
    seed: Annotated[int, shared.SEED] = 0
    seconds: float = 18.0
    """Duration of each drive in seconds; a rollout takes at most 16 s of it."""
    full_size: bool = False
    """Render images of 480x320 pixels as in runs, instead of 240x160 at a quarter of the cost."""
    workers: Annotated[int, shared.WORKERS] = 1
    device: Annotated[str, shared.PLANNER_DEVICE] = "auto"
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.synthetic import SCENES
        from recast_tools.planner_probe import ProbeRequest, probe, probe_table

        request = ProbeRequest(
            self.planner,
            self.out,
            self.scene or SCENES,
            self.motion or ("stationary", "oncoming", "cut-in"),
            self.seed,
            self.seconds,
            self.full_size,
            self.workers,
            self.device,
        )
        console = console_for(self.json)
        rows = probe(request, lambda row: console.print(row.line, markup=False, highlight=False))
        if self.json:
            print_json(_probe_rows(rows))
            return
        console.print(probe_table(rows))


def _probe_rows(rows: Sequence[ProbeRow]) -> Rows:
    """One row for each scene, scenario and view of the target (visible or erased)."""
    found: list[dict[str, Any]] = []
    for row in rows:
        for how in row.driven or ("",):
            found.append(
                {
                    "scene": row.scene,
                    "scenario": row.scenario,
                    "target": how or None,
                    "contact_s": row.collided.get(how),
                    "nearest_m": row.nearest.get(how),
                    "driven_m": row.driven.get(how),
                    "problem": row.problem,
                }
            )
    return {"rollouts": found}


Planner = shared.group(
    "planner",
    "Train a small image-conditioned planner: samples, training, test.",
    {
        "dataset": Dataset,
        "show": PlannerShow,
        "train": PlannerTrain,
        "export": PlannerExport,
        "probe": Probe,
    },
)
