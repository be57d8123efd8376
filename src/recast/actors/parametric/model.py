"""The trained parametric model: its file, designs predicted from an observation, and the generator
`parametric`, whose vehicles are complete and sharp from all sides."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from recast.actors.generate import VEHICLE, Asset, BaseGenerator
from recast.actors.observation import Observation
from recast.actors.parametric.codec import DesignCodec, ParametricVehicle, VehicleLook
from recast.actors.parametric.network import (
    ConditionImages,
    ParametricConfig,
    ParametricNetwork,
    Regressed,
    condition_of,
)
from recast.actors.template.body import TemplateBody
from recast.actors.template.cloud import SurfaceCloud, build_cloud
from recast.actors.template.design import VehicleDesign, ordered
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
from recast.arrays import Array, Int64Array
from recast.core.errors import InputError
from recast.core.files import atomic_file
from recast.core.torch_file import read_safetensors, require_state
from recast.geometry.colour import gamma_to_linear, linear_to_gamma
from recast.splats import MIP
from recast.weights import shipped_folder

PARAMETRIC = "recast-parametric"
"""Name of the model that comes with the package."""
MODEL_FILE = "model.safetensors"
_HEADER = "parametric"
_NOTCHED, _LID = 0.94, 0.04  # foot of the rear window of a car with a lid; its rounded edge
_SAMPLES = 3
_SPACING = 0.016
_FEW = 300  # painted patches below which the model knows better
_MEND = "train it again (recast recar parametric), or use the model of the package"


@dataclass(frozen=True)
class DesignPrediction:
    """What the model tells of one vehicle.

    Attributes:
        vehicle: means of all numbers and the likeliest of all choices.
        styles: probability of each body style, the likeliest first.
        uncertainty: standard deviation of each number by its path, such as "design.front.lamp_z".
        model: the model that tells it.
        known: (1, 128) what its flow is told.
    """

    vehicle: ParametricVehicle
    styles: dict[str, float]
    uncertainty: dict[str, float]
    model: ParametricModel
    known: Tensor

    def samples(self, seed: int, count: int = 1) -> list[ParametricVehicle]:
        """Vehicles that the flow draws; the same seed gives the same ones."""
        generator = torch.Generator().manual_seed(seed)
        network = self.model.network
        numbers, choices = network.apart(network.sample(self.known.expand(count, -1), generator))
        pairs = zip(numbers.double().numpy(), choices.numpy(), strict=True)
        return [self.model.vehicle(*pair) for pair in pairs]


class ParametricModel:
    """A network with the codec of what it reads.

    Args:
        network: network, in evaluation mode.
        codec: codec of the vehicles.
    """

    def __init__(self, network: ParametricNetwork, codec: DesignCodec) -> None:
        self.network, self.codec = network.eval(), codec

    @staticmethod
    def fresh(codec: DesignCodec | None = None, **sizes: Any) -> ParametricModel:
        """A model before training; `sizes` are members of `ParametricConfig`."""
        codec = codec or DesignCodec()
        choices = tuple(len(one.choices) for one in codec.choices)
        config = ParametricConfig(numbers=len(codec.numbers), choices=choices, **sizes)
        return ParametricModel(ParametricNetwork(config), codec)

    @staticmethod
    def load(path: Path) -> ParametricModel:
        """Read what `save` wrote.

        Raises:
            InputError: the file is missing or damaged, or was written for other fields of designs.
        """
        tensors, header = read_safetensors(path, "weights", _MEND)
        codec = DesignCodec()
        try:
            record = json.loads(header[_HEADER])
            codec.check(record["fields"], path)
            network = ParametricNetwork(ParametricConfig.model_validate(record["config"]))
        except InputError:  # which field of the designs differs
            raise
        except (KeyError, ValueError) as error:
            raise InputError(path, "config", f"is not usable: {error}", _MEND) from None
        plain = {name: tensor.float() for name, tensor in tensors.items()}
        require_state(path, plain, network.state_dict(), _MEND)
        network.load_state_dict(plain)
        return ParametricModel(network, codec)

    def save(self, path: Path) -> None:
        """Write the weights in half precision, with the codec's fields."""
        tensors = {name: value.detach().half() for name, value in self.network.named_parameters()}
        tensors |= {name: value.detach() for name, value in self.network.named_buffers()}
        config = self.network.config.model_dump(mode="json")
        # one member: safetensors writes several in no fixed order
        header = {_HEADER: json.dumps({"fields": self.codec.record, "config": config})}
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as partial:
            save_file({k: v.contiguous() for k, v in tensors.items()}, partial, metadata=header)

    def vehicle(self, numbers: Array, choices: Sequence[int] | Int64Array) -> ParametricVehicle:
        """The vehicle of numbers (N,) and indices of choices (M,), its landmarks in order."""
        vehicle = self.codec.decode(numbers, choices)
        assert isinstance(vehicle, ParametricVehicle)
        return replace(vehicle, design=_below_lid(ordered(vehicle.design)))

    @torch.no_grad()
    def predict(self, condition: ConditionImages) -> DesignPrediction:
        """The prediction for one photograph."""
        feature = self.network.encode(
            torch.from_numpy(condition.planes)[None], torch.from_numpy(condition.geometry)[None]
        )
        found = self.network.regress(feature)
        odds = found.logits[self._place("style")][0].softmax(dim=0).tolist()
        styles = dict(zip(self.codec.choices[self._place("style")].choices, odds, strict=True))
        return DesignPrediction(
            self._likeliest(found),
            dict(sorted(styles.items(), key=lambda one: -one[1])),
            self._deviations(found),
            self,
            self.network.known(feature, found),
        )

    def _place(self, path: str) -> int:
        return [one.path for one in self.codec.choices].index(path)

    def _likeliest(self, found: Regressed) -> ParametricVehicle:
        numbers: Array = self.network.natural(found.mean)[0].double().numpy()
        return self.vehicle(numbers, [int(one[0].argmax()) for one in found.logits])

    def _deviations(self, found: Regressed) -> dict[str, float]:
        spread = ((0.5 * found.logvar).exp() * self.network.spread)[0].double().numpy()
        return {
            one.path: float(np.round(value, 5))
            for one, value in zip(self.codec.numbers, spread, strict=True)
        }


def _below_lid(design: VehicleDesign) -> VehicleDesign:
    """The design with its tail lamps below the boot lid or the bed, whose top they would paint."""
    p, rear = design.proportions, design.rear
    highest = p.deck_z - _LID
    if p.tail_x > _NOTCHED or rear.lamp_high <= highest:
        return design
    low = min(rear.lamp_low, highest - 0.06)
    return replace(design, rear=replace(rear, lamp_high=highest, lamp_low=low))


@lru_cache(maxsize=2)
def parametric_model(path: Path | None = None) -> ParametricModel:
    """The model that comes with the package, or that of a file; read once.

    Raises:
        InputError: see `ParametricModel.load`.
    """
    return ParametricModel.load(path or shipped_folder(PARAMETRIC) / MODEL_FILE)


def predict_design(
    observation: Observation, model: ParametricModel | None = None
) -> DesignPrediction:
    """Style, sizes of parts, paint and light of the observed vehicle, with their uncertainty.

    Args:
        observation: its best view is used.
        model: model to use instead of the package's.

    Raises:
        InputError: see `ParametricModel.load`.
    """
    return (model or parametric_model()).predict(condition_of(observation))


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
