"""`recast recar train`: the adaptation of an image-to-3D model to vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared


@dataclass(frozen=True)
class RecarTrain:
    """Train the flows of an image-to-3D model towards pseudo-targets; the same command resumes.

    On several GPUs: torchrun --nproc-per-node 2 -m recast.cli.main recar train ...
    """

    model: Path
    """Model folder to start from (published layout), recast-mini (in the package) or trellis
    (recast weights)."""
    targets: Path
    """Cache of pseudo-targets, from `recast recar targets`."""
    set: Path
    """Vehicle set with the images, or a folder of training assets."""
    out: Path
    """Folder of the new model; the same command resumes."""
    stage: Annotated[
        Literal["1", "2", "base", "base-2", "mini-1", "mini-2"] | None,
        shared.option(
            "Stage of the paper: 1 (vehicles) or 2 (perturbed images); of the small model: base, "
            "base-2, mini-1 or mini-2."
        ),
    ] = None
    config: Annotated[
        Path | None,
        shared.option(
            'JSON file with all settings of a stage, or "preset" and the changes; instead of '
            "--stage."
        ),
    ] = None
    flow: Annotated[
        tyro.conf.UseAppendAction[tuple[Literal["structure", "latent"], ...]],
        shared.option(
            "Flow to train in this process; the model is written after the last flow.", "both"
        ),
    ] = ()
    image_encoder: Annotated[Path | None, shared.IMAGE_ENCODER] = None
    device: Annotated[str | None, shared.DEVICE] = None
    tensorboard: bool = False
    """Also write TensorBoard curves to OUT/tensorboard."""

    def __call__(self) -> None:
        from rich.console import Console

        from recast.recar.training import StageRequest, train_stage
        from recast.recar.training_config import chosen_stage
        from recast.training.loop import Processes
        from recast.weights import located

        config = chosen_stage(self.stage, self.config)
        request = StageRequest(
            config,
            located("--model", self.model),
            self.targets,
            self.set,
            self.out,
            located("--image-encoder", self.image_encoder),
            self.device,
            self.tensorboard,
            self.flow,
        )
        processes = Processes.started()
        left = train_stage(request, processes=processes)
        said = f"{self.out}: {', '.join(left)} still to train" if left else f"wrote {self.out}"
        Console(quiet=not processes.first).print(said, markup=False, soft_wrap=True)
