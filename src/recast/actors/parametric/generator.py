"""Generator `parametric`: vehicles from parameters alone, complete and sharp from all sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from recast.actors.generate import VEHICLE, Asset, BaseGenerator
from recast.actors.observation import Observation
from recast.actors.parametric.codec import VehicleLook
from recast.actors.parametric.model import ParametricModel, parametric_model, predict_design
from recast.actors.template.body import TemplateBody
from recast.actors.template.cloud import SurfaceCloud, build_cloud
from recast.actors.template.generator import SKETCHED, vehicle_gaussians
from recast.actors.template.lighting import (
    Daylight,
    estimate_light,
    estimate_rims,
    estimate_windows,
    road_light,
    road_tint,
    shown_patches,
)
from recast.actors.template.proportions import TemplatePlacement
from recast.actors.template.texture import view_surface
from recast.arrays import Array
from recast.geometry.colour import gamma_to_linear, linear_to_gamma
from recast.splats import MIP

_SAMPLES = 3
_SPACING = 0.016
_FEW = 300  # painted patches below which the model knows better


class ParametricGenerator(BaseGenerator):
    """Reads the template's parameters from the crop and builds the vehicle that they describe.

    Paint and light are measured on the photograph, as for the template, where the vehicle that was
    read shows enough paint in it: on two real cars the colours were nearer than the model's own.
    Nothing of the photograph is pasted on, so that no side is smeared. Further views are not used.

    Args:
        model: model to use instead of the one that comes with the package.
        spacing: metres between surface patches before merging.

    Raises:
        InputError: the weights were made for another version of the designs.
    """

    name = "parametric"

    def __init__(self, model: ParametricModel | None = None, spacing: float = _SPACING) -> None:
        self.model, self.spacing = model or parametric_model(), spacing

    def candidates(self, observation: Observation, seed: int) -> Sequence[Callable[[], Asset]]:
        """Sketches of the most likely vehicle and of three that the flow draws."""
        seeds = [0, *(seed + i + 1 for i in range(_SAMPLES))]
        return [partial(self._sketch, observation, one) for one in seeds]

    def generate(self, observation: Observation, seed: int) -> Asset:
        """The most likely vehicle for seed 0, else one that the flow draws with that seed."""
        return self._built(observation, seed, self.spacing)

    def _sketch(self, observation: Observation, seed: int) -> Asset:
        sketch = self._built(observation, seed, max(self.spacing, SKETCHED))
        return replace(sketch, finish=partial(self.generate, observation, seed))

    def _built(self, observation: Observation, seed: int, spacing: float) -> Asset:
        told = predict_design(observation, self.model)
        vehicle = told.samples(seed)[0] if seed else told.vehicle
        body = TemplateBody(observation.size, vehicle.design)
        cloud = build_cloud(body, spacing, np.random.default_rng(seed))
        finish = measured_finish(cloud, observation) or told_finish(vehicle.look, observation)
        return Asset(
            gaussians=vehicle_gaussians(
                body, cloud.dyed(finish.panes, finish.rims), finish.paint, finish.light
            ),
            axes=VEHICLE,
            generator=self.name,
            seed=seed,
            details={
                "style": vehicle.style,
                "style_probability": round(told.styles[vehicle.style], 3),
                "paint_srgb": " ".join(f"{v:.3f}" for v in linear_to_gamma(finish.paint)),
                "light": round(finish.light.level, 3),
                "clouds": round(finish.light.clouds, 3),
                "panes": f"{finish.panes[0]:.3f} {finish.panes[1]:.3f}",
                "rims": round(finish.rims, 3),
            },
            low_pass=MIP,
        )


@dataclass(frozen=True)
class VehicleFinish:
    """Colours of a vehicle and the light on it.

    Attributes:
        paint: (3,) linear reflectance.
        light: the light.
        panes: factors on the diffuse and the mirrored light of windows.
        rims: factor on the brightness of the wheels' metal.
    """

    paint: Array
    light: Daylight
    panes: tuple[float, float]
    rims: float


def told_finish(look: VehicleLook, observation: Observation) -> VehicleFinish:
    """What the model tells, in the hue of the road in the photograph."""
    tint = road_tint(road_light(replace(observation, further=())))
    light = Daylight(2.0**look.level, 2.0 ** (look.level + look.mirror), look.clouds, tint)
    paint = gamma_to_linear(np.array([look.red, look.green, look.blue]))
    return VehicleFinish(paint, light, (look.panes, look.pane_mirror), look.rims)


def measured_finish(cloud: SurfaceCloud, observation: Observation) -> VehicleFinish | None:
    """What the photograph shows on the patches that it sees; None if it sees little paint."""
    observation = replace(observation, further=())
    stands = np.array([0.0, 0.0, -float(observation.size[2]) / 2])
    seen = [view_surface(cloud, observation, TemplatePlacement(np.ones(3), stands, 1.0))]
    if len(shown_patches(seen, cloud.paint > 0.9)[0]) < _FEW:
        return None
    light, paint = estimate_light(cloud, seen, observation)
    panes, rims = estimate_windows(cloud, seen, light), estimate_rims(cloud, seen, light)
    return VehicleFinish(paint, light, panes, rims)
