"""`recast recar train`: one stage of the adaptation, from a model folder to a new one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Train:
    """Train the flows of an image-to-3D model towards pseudo-targets; continues what was killed.

    On several GPUs: torchrun --nproc-per-node 2 -m recast.cli.main recar train ...
    """

    model: Path
    """Model folder to start from, in the published layout, or trellis (see recast weights)."""
    targets: Path
    """Cache of pseudo-targets, of `recast recar targets`."""
    set: Path
    """Vehicle set with the pictures, in folders or shards; or a folder of training assets."""
    out: Path
    """Folder of the new model; new, or one of the same training, which is continued."""
    stage: Literal["1", "2", "base", "base-2", "mini-1", "mini-2"] | None = None
    """The paper's stage 1 (vehicles) or 2 (perturbed pictures); of the small model its base, or the
    two stages with its own figures."""
    config: Path | None = None
    """JSON file with every figure of a stage, or "preset" and what differs from it; instead of
    --stage."""
    flow: tyro.conf.UseAppendAction[tuple[Literal["structure", "latent"], ...]] = ()
    """Train this flow only, the other in another process or later; both where not given. The model
    is written when all flows of the stage are trained."""
    image_encoder: Path | None = None
    """Weights of the published image encoder (DINOv2 ViT-L/14 with registers), where the model
    folder has none; or dinov2 (see recast weights)."""
    device: str | None = None
    """Such as cpu or cuda:0; CUDA where there is some."""
    tensorboard: bool = False
    """Also write curves for TensorBoard into OUT/tensorboard."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.recar.training.processes import Processes
        from recast.recar.training.stage import train_stage
        from recast.recar.training.stage_parts import StageRequest
        from recast.recar.training.stage_presets import chosen_stage
        from recast.weights import located

        config = chosen_stage(self.stage, self.config)
        request = StageRequest(
            config, located("--model", self.model), self.targets, self.set, self.out,
            located("--image-encoder", self.image_encoder), self.device, self.tensorboard,
            self.flow,
        )  # fmt: skip
        processes = Processes.started()
        left = train_stage(request, processes=processes)
        said = f"{self.out}: {', '.join(left)} still to train" if left else f"wrote {self.out}"
        Console(quiet=not processes.first).print(said, markup=False, soft_wrap=True)
