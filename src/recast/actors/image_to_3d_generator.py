"""The paper's generator: the image-to-3D model, conditioned on the crop of the observation."""

from __future__ import annotations

from pathlib import Path

from recast.actors.axes import UNIT_CUBE_X_FORWARD, UNIT_CUBE_Z_UP, AxisConvention
from recast.actors.generate import Asset
from recast.actors.observation import Observation
from recast.trellis import RECAST_MINI, GenerationLimits, ImageTo3D, generate, recast_mini


class ImageTo3DGenerator:
    """Generates the vehicle from its RGBA crop (RECAST, section 2, inference).

    Args:
        folder: model in the published layout, see `ImageTo3D.load`.
        image_encoder: weights of the published image encoder, where the folder has none.
        limits: what counts as a failed structure; three further seeds by default, since a whole
            run should not end because one of them failed.
        name: for the record.
        axes: of what the model makes; published ones give any heading.

    Raises:
        InputError: see `ImageTo3D.load`.
    """

    def __init__(
        self,
        folder: str | Path,
        image_encoder: str | Path | None = None,
        limits: GenerationLimits | None = None,
        name: str = "image-to-3d",
        axes: AxisConvention = UNIT_CUBE_Z_UP,
    ) -> None:
        self.name, self.axes = name, axes
        self.folder = Path(folder)
        self.model = ImageTo3D.load(self.folder, image_encoder=image_encoder)
        self.limits = limits or GenerationLimits(retries=3)

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Generate from the crop.

        Raises:
            InputError: the mask is unusable, or the structure failed with every seed allowed.
        """
        made = generate(
            self.model, [[observation.rgba]], [seed],
            names=[f"crop of track {observation.track_id}"], limits=self.limits,
        )  # fmt: skip
        vehicle = made.vehicles[0]
        return Asset(
            vehicle.gaussians, self.axes, self.name, vehicle.seed,
            {"model": self.folder.resolve().name, "voxels": len(vehicle.coords)},
            self.model.low_pass,
        )  # fmt: skip


def recast_mini_generator() -> ImageTo3DGenerator:
    """The small model that comes with the package."""
    return ImageTo3DGenerator(recast_mini(), name=RECAST_MINI, axes=UNIT_CUBE_X_FORWARD)
