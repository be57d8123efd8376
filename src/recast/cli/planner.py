"""`recast planner vocabulary | dataset | train | export | probe`: the small planner's recipe."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Vocabulary:
    """Cluster plausible driving into the trajectories that a planner chooses from."""

    out: Path
    """File to write, .npy."""
    size: int = 512
    """Number of trajectories."""
    seed: int = 0
    """Seed of everything random."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.planning.gtrs import write_vocabulary
        from recast.planning.gtrs_training.vocabulary import make_vocabulary

        write_vocabulary(self.out, make_vocabulary(self.size, self.seed))
        Console().print(f"wrote {self.out}: {self.size} trajectories", markup=False)


@dataclass(frozen=True)
class Dataset:
    """Render and score training samples in synthetic worlds; continues what was killed."""

    vocabulary: Path
    """File of `recast planner vocabulary`; copied into the folder."""
    out: Path
    """Folder; one of the same settings grows."""
    samples: int = 8000
    """At least so many; whole worlds are made."""
    seed: int = 0
    """Seed of everything random."""
    per_world: int = 32
    """Samples of each world."""
    workers: int = 1
    """Processes; the files are the same for any number."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.planner_data.dataset import make_dataset
        from recast.planning.gtrs import read_vocabulary
        from recast.planning.gtrs_training.store import DatasetRecord
        from recast.recar.progress import PictureProgress
        from recast.synthetic import SCENES

        console = Console()
        record = DatasetRecord(seed=self.seed, per_world=self.per_world, scenes=SCENES)
        vocabulary = read_vocabulary(self.vocabulary)
        with PictureProgress("samples", console) as progress:
            made = make_dataset(
                self.out, self.samples, record, vocabulary, workers=self.workers, progress=progress
            )
        console.print(f"wrote {self.out}: {made} samples", markup=False)


@dataclass(frozen=True)
class Show:
    """Draw samples of a dataset: pictures, and from above the trajectories that score best."""

    dataset: tyro.conf.Positional[Path]
    """Folder of `recast planner dataset`."""
    out: Path
    """PNG to write."""
    count: int = 12
    """Samples."""
    first: int = 0
    """Index of the first one."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.planning.gtrs_training.sheet import truth_sheet
        from recast.planning.gtrs_training.store import SampleStore

        truth_sheet(SampleStore(self.dataset), self.first, self.count).write(self.out)


@dataclass(frozen=True)
class Train:
    """Train the small planner on samples; continues what was killed, to the same weights."""

    dataset: Path
    """Folder of `recast planner dataset`; its vocabulary is learnt. Every tenth world is held
    out."""
    out: Path
    """Folder of the training."""
    config: Path | None = None
    """JSON file with what differs from the shipped planner's training, such as
    {"trainer": {"steps": 4000}}."""
    start: Path | None = None
    """Folder of a planner of the same sizes whose weights are the first; drawn where not given."""
    seed: int = 0
    """Seed of everything random."""
    steps: int | None = None
    """Of the optimiser; as for the shipped planner where not given."""
    threads: int = 1
    """Of torch; sums may round differently for another number."""

    def __call__(self) -> None:
        """Run the command."""
        import torch
        from rich.console import Console

        from recast.planning.gtrs_training.settings import chosen_training
        from recast.planning.gtrs_training.train import train_planner

        torch.set_num_threads(self.threads)
        console = Console()
        config = chosen_training(self.config, self.seed, self.steps)
        reached = train_planner(self.dataset, self.out, config, console, self.start)
        for name, value in reached.means().items():
            console.print(f"{name}: {value:.4g}", highlight=False)
        console.print(f"wrote {self.out}; next: recast planner export {self.out}", markup=False)


@dataclass(frozen=True)
class Export:
    """Write the planner of a training as a folder, which is then a planner's name."""

    training: tyro.conf.Positional[Path]
    """Folder of `recast planner train`; it need not be finished."""
    dataset: Path
    """What it was trained on."""
    out: Path
    """Folder to write; must not exist."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.planning.gtrs_training.train import export_planner

        export_planner(self.training, self.dataset, self.out)
        size = sum(path.stat().st_size for path in self.out.iterdir())
        Console().print(f"wrote {self.out}: {size / 1e6:.1f} MB", markup=False)


@dataclass(frozen=True)
class Probe:
    """Does it look? Drive with the target in the pictures, and with it erased from them."""

    planner: tyro.conf.Positional[str]
    """A planner that reads images: a name, or a folder of `recast planner export`."""
    out: Path
    """Folder; rollouts that the same planner left there are used again."""
    scene: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Synthetic scenes; all where not given."""
    motion: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Scenarios; stationary, oncoming and cut-in where not given."""
    seed: int = 0
    """Of the worlds."""
    seconds: float = 18.0
    """Of each world's drive; a rollout takes 16 s of it, or less where the road ends."""
    full_size: bool = False
    """Render 480x320 as in runs. Else 240x160, at a quarter of the cost: what a small planner sees
    is the same size."""
    workers: int = 1
    """Processes that render side by side."""
    device: str = "auto"
    """Where the planner computes: auto (a GPU where there is one), cpu, cuda or cuda:1."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.planner_data.probe import ProbeRequest, probe, probe_table
        from recast.synthetic import SCENES

        request = ProbeRequest(
            self.planner, self.out, self.scene or SCENES,
            self.motion or ("stationary", "oncoming", "cut-in"), self.seed, self.seconds,
            self.full_size, self.workers, self.device,
        )  # fmt: skip
        console = Console()
        rows = probe(request, lambda row: console.print(row.line, markup=False, highlight=False))
        console.print(probe_table(rows))


@dataclass(frozen=True)
class Planner:
    """Make a small image-conditioned planner: vocabulary, samples, training, proof."""

    command: (
        Annotated[Vocabulary, tyro.conf.subcommand("vocabulary")]
        | Annotated[Dataset, tyro.conf.subcommand("dataset")]
        | Annotated[Show, tyro.conf.subcommand("show")]
        | Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Export, tyro.conf.subcommand("export")]
        | Annotated[Probe, tyro.conf.subcommand("probe")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
