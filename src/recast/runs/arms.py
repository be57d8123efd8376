"""Arms: what is compared. Whose street, whose vehicle in the target's place, and what renders it.

Words and files on the command line stand for arms; docs/runs.md#arms lists them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, Self, get_args

from pydantic import Field, model_validator

from recast.actors.vehicle_files import VEHICLE_SUFFIXES
from recast.core import files
from recast.core.errors import InputError, nearest
from recast.core.plugins import GENERATORS
from recast.core.records import Record, validated
from recast.core.yaml_lines import nodes_of, read_yaml_file
from recast.reconstruction.config import Preset
from recast.scene.store import SCENE_FILE
from recast.simulation.rollout import ANY_VEHICLE
from recast.weights import PUBLISHED

OWN_STREET = "recast"
"""The street that the run's own scene settings or `scene_folder` name."""
PRESETS: tuple[Preset, ...] = get_args(Preset)
ASSETS = "assets:"
MOST_VIEWS = 24
"""Views of a target, at most: one every 15 degrees all around."""
TRUTH = "truth"
"""The true street of a synthetic log, and the true vehicle."""
Noise = Literal["seed", "grey", "jitter", "start"]
NOISES: tuple[Noise, ...] = get_args(Noise)
START_LEFT_M = 0.05
"""Metres to the left at which the ego starts under the noise "start"."""


class Arm(Record):
    """What one column of a comparison shows."""

    name: str = Field(min_length=1, max_length=100, description="name in tables and file names")
    street: str = Field(
        default=OWN_STREET,
        description=("recast (the run's own street), a preset, the folder of a scene, or truth"),
    )
    vehicle: Literal["own", "generated", "truth", "none"] = Field(
        description=(
            "vehicle in the target's place: the street's own reconstruction, a "
            "generated one, the truth, or none in the images"
        )
    )
    generator: str | None = Field(
        default=None, description="generator of a generated vehicle; null: the run's"
    )
    axes: str | None = Field(
        default=None, description="axes of vehicle files or of a model folder; null: the run's"
    )
    refine: bool | None = Field(
        default=None, description="whether the vehicle is refined; null: the run's choice"
    )
    relit: bool | None = Field(
        default=None, description="whether the vehicle is lit as in the street; null: true"
    )
    segmenter: str | None = Field(
        default=None, description="segmenter of the target; null: the run's"
    )
    views: int | None = Field(
        default=None,
        ge=1,
        le=MOST_VIEWS,
        description="maximum number of views that the vehicle is made from; null: the run's",
    )
    noise: Noise | None = Field(
        default=None,
        description=(
            "disturbance: a grey level up or down, a pixel to the right, a start 5 cm to the left, "
            "or camera noise of another seed (only for the truth)"
        ),
    )

    @classmethod
    def native(cls, street: str = OWN_STREET) -> Self:
        """A street with its own reconstruction of the target."""
        name = "native" if street == OWN_STREET else _short(street)
        return cls(name=name, street=street, vehicle="own")

    @classmethod
    def replaced(cls, generator: str | None = None, street: str = OWN_STREET) -> Self:
        """A street with a generated vehicle in the target's place."""
        name = "replaced" if generator is None else _short(generator)
        if street != OWN_STREET:
            name = f"{_of_street(street)}+{name}"
        return cls(name=name, street=street, vehicle="generated", generator=generator)

    @classmethod
    def oracle(cls, street: str = TRUTH) -> Self:
        """The truth of a synthetic log; or the true vehicle in another street."""
        name = "oracle" if street == TRUTH else f"{_of_street(street)}+oracle"
        return cls(name=name, street=street, vehicle="truth")

    @classmethod
    def empty(cls, street: str = OWN_STREET) -> Self:
        """A street whose images show no vehicle in the target's place."""
        return cls(name=f"{_of_street(street)}+none", street=street, vehicle="none")

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        if self.street == TRUTH and self.vehicle == "own":
            raise ValueError("the true street has no reconstruction of the vehicle")
        if self.noise == "seed" and not self.is_truth:
            raise ValueError(
                "only the truth has camera noise, so no other arm can have the noise seed"
            )
        given = (self.generator, self.axes, self.refine, self.relit, self.segmenter, self.views)
        if self.vehicle != "generated" and any(value is not None for value in given):
            raise ValueError(
                "only a generated vehicle can have generator, axes, refine, relit, segmenter, views"
            )
        return self

    def disturbed(self, noise: Noise) -> Self:
        """The same arm under a disturbance.

        Raises:
            ValueError: it has no such noise.
        """
        fields = {**self.model_dump(), "name": f"{self.name}:{noise}", "noise": noise}
        return type(self).model_validate(fields)

    @property
    def noises(self) -> tuple[Noise, ...]:
        """The disturbances that it can have."""
        return tuple(noise for noise in NOISES if noise != "seed" or self.is_truth)

    @property
    def is_truth(self) -> bool:
        """Whether street and vehicle are what is really there, disturbed or not."""
        return self.vehicle == "truth" and not self.reconstructs

    @property
    def reconstructs(self) -> bool:
        """Whether its street is a reconstruction."""
        return self.street != TRUTH

    @property
    def of_the_log(self) -> bool:
        """Whether it shows street and target as they were reconstructed or generated, undisturbed:
        then its images of the log's own moments should show what was recorded."""
        return self.reconstructs and self.vehicle in ("own", "generated") and self.noise is None

    @property
    def needs_world(self) -> bool:
        """Whether street or vehicle are the truth, which only a synthetic log has."""
        return self.vehicle == "truth" or not self.reconstructs

    @property
    def restorable(self) -> bool:
        """Whether a restorer improves its images; those that show only the truth stay as they
        are."""
        return self.reconstructs or self.generates

    @property
    def made_in(self) -> str:
        """The reconstruction that its generated vehicle is refined in and takes its light from: its
        street; or the run's own, if that is the truth."""
        return self.street if self.reconstructs else OWN_STREET

    @property
    def start_left(self) -> float:
        """Metres to the left of where the log has it at which the ego starts."""
        return START_LEFT_M if self.noise == "start" else 0.0

    @property
    def generates(self) -> bool:
        """Whether a generated vehicle stands in the target's place."""
        return self.vehicle == "generated"

    def label(self, noun: str = ANY_VEHICLE) -> str:
        """Its name for people, who call the target by a noun."""
        shown = (
            (Arm.native(), "reconstructed"),
            (Arm.replaced(), "replaced"),
            (Arm.oracle(), "true"),
        )
        return next((f"{word} {noun}" for arm, word in shown if arm == self), self.name)

    def inputs(self) -> dict[str, Any]:
        """What keys of its images need beside the keys of its street and its vehicles."""
        found: dict[str, Any] = {}
        if self.vehicle == "none" or (self.vehicle == "truth" and self.reconstructs):
            found["vehicle"] = self.vehicle
        if self.relit is False:
            found["relit"] = False
        if self.noise is not None:
            found["noise"] = self.noise
        return found

    def of_scene(self, scene: str) -> Arm:
        """The arm with the file of a scene where its generator is `assets:DIR`.

        Raises:
            InputError: there is no such file.
        """
        if self.generator is None or not self.generator.startswith(ASSETS):
            return self
        folder = Path(self.generator.removeprefix(ASSETS))
        names = [f"{scene}{suffix}" for suffix in VEHICLE_SUFFIXES]
        found = next((folder / name for name in names if (folder / name).is_file()), None)
        if found is None:
            raise InputError(
                folder, f"scene {scene}", "has no vehicle file", f"add {' or '.join(names)}"
            )
        return self.model_copy(update={"generator": str(found)})


def default_arms() -> tuple[Arm, ...]:
    """The street's own reconstruction, which is the baseline, and a generated vehicle."""
    return Arm.native(), Arm.replaced()


def truth_of(arms: Sequence[Arm]) -> str | None:
    """The name of the arm that shows the truth, undisturbed; None where none does."""
    return next((arm.name for arm in arms if arm.is_truth and arm.noise is None), None)


def disturbed_arms(arm: Arm, arms: Sequence[Arm]) -> tuple[Arm, ...]:
    """Those of `arms` that are an arm under some disturbance."""
    return tuple(one for one in under_other_noise(arm, arms) if one.noise is not None)


def under_other_noise(arm: Arm, arms: Sequence[Arm]) -> tuple[Arm, ...]:
    """Those of `arms` that differ from an arm, disturbed or not, by their noise alone."""
    same = arm.model_dump(exclude={"name", "noise"})
    found = (one for one in arms if one.noise != arm.noise)
    return tuple(one for one in found if one.model_dump(exclude={"name", "noise"}) == same)


def require_undisturbed(arms: Sequence[Arm]) -> None:
    """Refuse noise without the arm that it disturbs.

    Raises:
        InputError: the arm that a noise disturbs is not among the arms.
    """
    plain = [arm for arm in arms if arm.noise is None]
    compared = {noisy.name for arm in plain for noisy in disturbed_arms(arm, arms)}
    for arm in arms:
        if arm.noise is not None and arm.name not in compared:
            problem = "is compared with the undisturbed arm, which is not among the arms"
            mend = f"add `arm` {arm.name.removesuffix(f':{arm.noise}')}"
            raise InputError("`arm`", arm.name, problem, mend)


def _short(word: str) -> str:
    """A name for tables: of a path only its last part."""
    prefix, colon, rest = word.partition(":")
    if colon and "/" in rest:
        return f"{prefix}:{Path(rest).name}"
    return Path(word).name if "/" in word else word


def _of_street(street: str) -> str:
    """What names of arms call a street."""
    return "oracle" if street == TRUTH else _short(street)


PAPER = "paper"
"""The word for the paper's seven arms, and for its configuration; see docs/reproduce.md."""
PAPER_FOLDER = Path(__file__).parent / "paper"
DECOMPOSITION = "decomposition"
"""The word for `decomposition_arms`."""
NOISE_FLOOR = "noise-floor"
"""The word for the truth under each kind of noise."""
_LARGEST_FILE = 1_000_000  # bytes
_MEND = "correct it; see docs/runs.md#arms"
_ALL_NOISE = "noise"


def parse_arms(words: Sequence[str]) -> tuple[Arm, ...]:
    """The arms that words on the command line stand for, in their order.

    Args:
        words: see docs/runs.md#arms; or files (.json, .yaml) with a list of `Arm` records.

    Raises:
        InputError: a word or file is wrong, or two arms have one name.
    """
    arms = [arm for word in words for arm in _arms_of(word)]
    names = [arm.name for arm in arms]
    for name in names:
        if names.count(name) > 1:
            raise InputError("`arm`", name, "is named twice", "name each arm once")
    return tuple(arms)


def is_street(word: str) -> bool:
    """Whether a word names a street: a preset, the run's own, or the folder of a scene."""
    return word in (OWN_STREET, *PRESETS) or (Path(word) / SCENE_FILE).is_file()


def _arms_of(word: str) -> Sequence[Arm]:
    if word.lower().endswith((".json", ".yaml", ".yml")):
        return _read_arms(Path(word))
    if word == PAPER:
        return _read_arms(PAPER_FOLDER / "arms.yaml")
    if word == DECOMPOSITION:
        return decomposition_arms()
    if word == NOISE_FLOOR:
        return _disturbed(Arm.oracle())
    by_name = {arm.name: arm for arm in (*default_arms(), Arm.oracle())}
    if word in by_name:
        return [by_name[word]]
    plain, colon, noise = word.rpartition(":")
    if colon and (noise in (*NOISES, _ALL_NOISE) or plain in by_name):
        return [one for arm in _arms_of(plain) for one in _disturbed(arm, noise)]
    if is_street(word):
        return [Arm.native(word)]
    street, plus, vehicle = word.partition("+")
    street = TRUTH if street == Arm.oracle().name else street
    if plus and (street == TRUTH or is_street(street)):
        return [_combined(word, street, vehicle)]
    _require_generator(word, word)
    return [Arm.replaced(word)]


def _require_generator(word: str, generator: str) -> None:
    """Refuse an arm that can only be a generator, and is not one.

    Names of installed parts, weights and paths are looked up when the arm is made.
    """
    weights = PUBLISHED.get(generator)
    names = GENERATORS.names()
    if (
        generator in names
        or (weights and weights.part == GENERATORS.kind)
        or any(mark in generator for mark in (":", "/", os.sep, "."))
        or Path(generator).exists()
    ):
        return
    arms = [*(arm.name for arm in (*default_arms(), Arm.oracle())), *names, *PRESETS]
    arms += [PAPER, DECOMPOSITION, NOISE_FLOOR]
    near = nearest(generator, arms)
    hint = (
        f"did you mean {near}?"
        if near
        else f"choose one of {', '.join(arms)}, or give a file of arms"
    )
    raise InputError("`arm`", word, "is not known", hint)


def _disturbed(arm: Arm, noise: str = _ALL_NOISE) -> Sequence[Arm]:
    """An arm under one kind of noise, or under each that it can have."""
    chosen = [one for one in arm.noises if noise in (one, _ALL_NOISE)]
    if not chosen:
        named = ", ".join(f"{arm.name}:{one}" for one in (*arm.noises, _ALL_NOISE))
        problem = f"cannot be disturbed by {noise!r}"
        raise InputError("`arm`", f"{arm.name}:{noise}", problem, f"choose one of {named}")
    return [arm.disturbed(one) for one in chosen]


def _combined(word: str, street: str, vehicle: str) -> Arm:
    """The arm of a street and a vehicle."""
    if vehicle == "oracle":
        return Arm.oracle(street)
    if vehicle == "none":
        return Arm.empty(street)
    if vehicle not in ("native", "replaced"):
        _require_generator(word, vehicle)
    if vehicle != "native":
        return Arm.replaced(None if vehicle == "replaced" else vehicle, street)
    if street == TRUTH:
        problem = "the true street has no reconstruction of the vehicle"
        raise InputError("`arm`", word, problem, "give a generator, replaced or none after the +")
    return Arm.native(street)


def _read_arms(path: Path) -> Sequence[Arm]:
    if path.suffix.lower() == ".json":
        values = nodes_of(files.read_json(path), str(path))
    else:
        values = read_yaml_file(path, _LARGEST_FILE)
    if not isinstance(values.value, list) or not values.value:
        raise InputError(path, "arms", "is not a list of arms", _MEND)
    return [validated(node.place, node.plain, Arm, _MEND) for node in values.value]


def decomposition_arms() -> tuple[Arm, ...]:
    """Truth and reconstruction of street and vehicle in all pairings, and the vehicle without the
    light of its place and without its refinement."""
    replaced = Arm.replaced()
    return (
        Arm.native(),
        replaced,
        Arm.oracle(),
        Arm.oracle(OWN_STREET),
        Arm.replaced(street=TRUTH),
        replaced.model_copy(update={"name": "replaced, unlit", "relit": False}),
        replaced.model_copy(update={"name": "replaced, unrefined", "refine": False}),
        Arm.empty(TRUTH),
        Arm.empty(),
    )
