"""`recast actor generate`: vehicles from crops, without a log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from rich.console import Console

from recast.actors import orbit
from recast.core import files
from recast.core.errors import InputError
from recast.reporting.video import write_video
from recast.runs.display import SamplingProgress
from recast.splats import Gaussians, LowPass, write_ply
from recast.trellis import (
    GeneratedVehicle,
    Generation,
    GenerationLimits,
    ImageTo3D,
    MultiImageMode,
    SamplerSettings,
    crop_to_object,
    generate,
    read_crop,
    viewer_frame,
)

_FILM_VIEWS = 72
_FILM_SIZE = (640, 360)


@dataclass(frozen=True)
class GenerationRequest:
    """What to generate.

    Attributes:
        steps: sampling steps of both samplers; the checkpoint's where None.
        cfg: guidance strengths of structure and latent; likewise.

    Raises:
        InputError: no crop, views of several vehicles, or two crops of one name.
    """

    crops: tuple[Path, ...]
    views: tuple[Path, ...]
    seed: int
    mode: MultiImageMode
    steps: int | None
    cfg: tuple[float, float] | None
    limits: GenerationLimits

    def __post_init__(self) -> None:
        if not self.crops:
            raise InputError("CROP", "images", "none are given", "name at least one RGBA image")
        if self.views and len(self.crops) > 1:
            raise InputError(
                "`views`",
                f"{len(self.views)} images",
                f"are given with {len(self.crops)} crops, but show one vehicle only",
                "give one crop, and generate the other vehicles in further calls",
            )
        names = [crop.stem for crop in self.crops]
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    "CROP",
                    name,
                    "is the name of two images",
                    "rename one: it names the output folder",
                )

    def samplers(self, model: ImageTo3D) -> tuple[SamplerSettings, SamplerSettings]:
        """The checkpoint's, of structure and latent, with what was asked for otherwise."""
        structure, latent = self.cfg or (None, None)
        return (
            model.structure_settings.merged(steps=self.steps, cfg_strength=structure),
            model.latent_settings.merged(steps=self.steps, cfg_strength=latent),
        )


def load_model(
    folder: Path, device: str | None, precision: str | None, image_encoder: Path | None
) -> ImageTo3D:
    """Load a model folder.

    Args:
        device: a torch device; CUDA where there is some, if None.
        precision: float16, bfloat16 or float32; the device's usual one if None.

    Raises:
        InputError: no such device, or see `ImageTo3D.load`.
    """
    try:
        if device is not None:
            torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            "`device`", device or "", reason, "name a device of this machine"
        ) from None
    dtype: torch.dtype | None = None if precision is None else getattr(torch, precision)
    return ImageTo3D.load(folder, device=device, torso_dtype=dtype, image_encoder=image_encoder)


def cost_lines(made: Generation) -> list[str]:
    """What was made, and what it cost, for people."""
    times = ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in made.seconds.items())
    vehicles = [
        f"{len(one.coords)} voxels, {len(one.gaussians)} Gaussians, seed {one.seed}"
        for one in made.vehicles
    ]
    return [*vehicles, f"{times}; peak memory {made.peak_bytes / 2**30:.2f} GiB"]


def generate_actors(
    request: GenerationRequest, model: ImageTo3D, out: Path, console: Console
) -> Generation:
    """Generate, film and write; one crop into `out`, several into folders named by them.

    Each folder holds `vehicle.ply` (native frame), `viewer.ply` (-y up), `turntable.mp4`,
    `condition.png` (what the image encoder saw) and `generation.json`; `cost.json` beside them
    tells times and memory.

    Raises:
        InputError: an unusable crop, a structure that failed, or `out` exists.
    """
    pictures = [[read_crop(path) for path in (crop, *request.views)] for crop in request.crops]
    structure, latent = request.samplers(model)
    with files.atomic_folder(out) as folder:
        with SamplingProgress(console) as progress:
            made = generate(
                model,
                pictures,
                [request.seed] * len(pictures),
                names=[str(crop) for crop in request.crops],
                mode=request.mode,
                structure=structure,
                latent=latent,
                limits=request.limits,
                progress=progress,
            )
        for crop, views, vehicle in zip(request.crops, pictures, made.vehicles, strict=True):
            target = folder if len(pictures) == 1 else folder / crop.stem
            target.mkdir(exist_ok=True)
            seen = [crop_to_object(view, model.encoder.image_size) for view in views]
            Image.fromarray(np.hstack(seen)).save(target / "condition.png")
            _write_vehicle(target, vehicle, model.low_pass)
            files.write_json(target / "generation.json", _record(request, model, crop, vehicle))
        files.write_json(
            folder / "cost.json", {"seconds": dict(made.seconds), "peak_bytes": made.peak_bytes}
        )
    return made


def _write_vehicle(folder: Path, vehicle: GeneratedVehicle, low_pass: LowPass) -> None:
    write_ply(folder / "vehicle.ply", vehicle.gaussians, low_pass)
    write_ply(folder / "viewer.ply", viewer_frame(vehicle.gaussians), low_pass)
    width, height = _FILM_SIZE
    made, views = vehicle.gaussians, _FILM_VIEWS
    frames = orbit(made, _extents(made), views=views, width=width, height=height, low_pass=low_pass)
    write_video(folder / "turntable.mp4", frames, fps=_FILM_VIEWS / 6)


def _extents(gaussians: Gaussians) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(3,) twice how far the visible centres reach from the origin along each axis."""
    seen = gaussians.means[torch.sigmoid(gaussians.logit_opacities) > 0.1]
    if len(seen) == 0:
        seen = gaussians.means
    reach = torch.quantile(seen.abs()[:: max(len(seen) // 100_000, 1)], 0.995, dim=0)
    return 2 * reach.clamp(min=0.05).double().cpu().numpy()


def _record(
    request: GenerationRequest, model: ImageTo3D, crop: Path, vehicle: GeneratedVehicle
) -> dict[str, Any]:
    folder = model.checkpoint.folder
    assert folder is not None  # it was loaded from one
    structure, latent = request.samplers(model)
    return {
        "model": folder.resolve().name,
        "crop": crop.name,
        "views": [view.name for view in request.views],
        "multi_image": request.mode,
        "seed": vehicle.seed,
        "seed_asked_for": request.seed,
        "structure": structure.model_dump(mode="json"),
        "latent": latent.model_dump(mode="json"),
        "voxels": len(vehicle.coords),
        "gaussians": len(vehicle.gaussians),
    }
