"""Arms: what is compared. Whose street, whose vehicle in the target's place, and what renders it.

docs/runs.md#arms lists the words that stand for arms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, get_args

import yaml
from pydantic import Field, ValidationError, model_validator

from recast.actors import Actor
from recast.actors.coverage import CoverageMeter
from recast.actors.mesh import MESH_SUFFIXES
from recast.core import files
from recast.core.errors import InputError
from recast.core.records import Record, validation_error
from recast.pipeline.paper import PAPER, paper_arms
from recast.planning import CameraMount
from recast.scene import Preset, StreetScene
from recast.scene.store import SCENE_FILE
from recast.simulation import SensorRenderer
from recast.simulation.scene_renderer import SceneRenderer, through_lenses

if TYPE_CHECKING:
    from recast.synthetic import World

OWN_STREET = "recast"
"""The street that the run's own scene settings or `scene_folder` name."""
PRESETS: tuple[Preset, ...] = get_args(Preset)
ASSETS = "assets:"
MOST_VIEWS = 24
"""Of a target: one every 15 degrees all around."""
_TRUTH = "truth"
_LARGEST_FILE = 1_000_000  # bytes
_MEND = "see docs/runs.md for what an arm is"


class Arm(Record):
    """What one column of a comparison shows."""

    name: str = Field(min_length=1, max_length=100, description="name in tables and file names")
    street: str = Field(
        default=OWN_STREET,
        description=("recast (the run's own street), a preset, the folder of a scene, or truth"),
    )
    vehicle: Literal["own", "generated", "truth"] = Field(
        description=(
            "vehicle in the target's place: the street's own reconstruction, a "
            "generated one, or the truth"
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
    segmenter: str | None = Field(
        default=None, description="segmenter of the target; null: the run's"
    )
    views: int | None = Field(
        default=None,
        ge=1,
        le=MOST_VIEWS,
        description="maximum number of views that the vehicle is made from; null: the run's",
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
            name = f"{_short(street)}+{name}"
        return cls(name=name, street=street, vehicle="generated", generator=generator)

    @classmethod
    def oracle(cls) -> Self:
        """The truth, of a synthetic log."""
        return cls(name="oracle", street=_TRUTH, vehicle="truth")

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        if (self.street == _TRUTH) != self.is_truth:
            raise ValueError("street and vehicle are both the truth, or neither is")
        given = (self.generator, self.axes, self.refine, self.segmenter, self.views)
        if self.vehicle != "generated" and any(value is not None for value in given):
            raise ValueError("only a generated vehicle has generator, axes, refine and the like")
        return self

    @property
    def is_truth(self) -> bool:
        """Whether it shows what is really there."""
        return self.vehicle == "truth"

    @property
    def generates(self) -> bool:
        """Whether a generated vehicle stands in the target's place."""
        return self.vehicle == "generated"

    @property
    def label(self) -> str:
        """Its name for people."""
        if self.is_truth:
            return f"truth ({self.name})"
        return f"{self.name} actor" if self in (Arm.native(), Arm.replaced()) else self.name

    def of_scene(self, scene: str) -> Arm:
        """The arm with the file of a scene where its generator is `assets:DIR`.

        Raises:
            InputError: there is no such file.
        """
        if self.generator is None or not self.generator.startswith(ASSETS):
            return self
        folder = Path(self.generator.removeprefix(ASSETS))
        names = [f"{scene}{suffix}" for suffix in (".ply", *MESH_SUFFIXES)]
        found = next((folder / name for name in names if (folder / name).is_file()), None)
        if found is None:
            raise InputError(folder, f"scene {scene}", "has no file", f"add {' or '.join(names)}")
        return self.model_copy(update={"generator": str(found)})


def default_arms() -> tuple[Arm, ...]:
    """The street's own reconstruction, which is the baseline, and a generated vehicle."""
    return Arm.native(), Arm.replaced()


def truth_of(arms: Sequence[Arm]) -> str | None:
    """The name of the arm that shows the truth; None where none does."""
    return next((arm.name for arm in arms if arm.is_truth), None)


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
        return _read_arms(paper_arms())
    by_name = {arm.name: arm for arm in (*default_arms(), Arm.oracle())}
    if word in by_name:
        return [by_name[word]]
    if is_street(word):
        return [Arm.native(word)]
    street, plus, vehicle = word.partition("+")
    if not (plus and is_street(street)):
        return [Arm.replaced(word)]
    if vehicle not in by_name:
        return [Arm.replaced(vehicle, street)]
    if by_name[vehicle].is_truth:
        raise InputError("`arm`", word, "puts the truth into a reconstruction", _MEND)
    arm = Arm.native(street) if vehicle == Arm.native().name else Arm.replaced(None, street)
    return [arm]


def _read_arms(path: Path) -> Sequence[Arm]:
    text = files.read_text(path, _LARGEST_FILE)
    try:
        values: Any = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(path, "arms", f"cannot be read ({reason})", _MEND) from None
    if not isinstance(values, list) or not values:
        raise InputError(path, "arms", "are no list", _MEND)
    try:
        return [Arm.model_validate(value) for value in values]
    except ValidationError as error:
        raise validation_error(path, error, _MEND) from None


def _short(word: str) -> str:
    """A name for tables: of a path only its last part."""
    prefix, colon, rest = word.partition(":")
    if colon and "/" in rest:
        return f"{prefix}:{Path(rest).name}"
    return Path(word).name if "/" in word else word


StreetOf = Callable[[Arm, tuple[str, ...]], StreetScene]
"""Gives the street of an arm with the vehicles of these tracks replaced, if the arm does that."""


class Renderers:
    """Renderers, made when first asked for and kept; close it, as some hold processes.

    Args:
        actor_of: gives the vehicle that an arm puts in the place of a track.
        world_of: gives the world of a synthetic log.
        oracle_workers: processes of an oracle, see `OracleRenderer`.
    """

    def __init__(
        self,
        street_of: StreetOf,
        actor_of: Callable[[Arm, str], Actor],
        world_of: Callable[[], World],
        oracle_workers: int = 0,
    ) -> None:
        self._street_of, self._actor_of, self._world_of = street_of, actor_of, world_of
        self._oracle_workers = oracle_workers
        self._open = ExitStack()
        self._streets: dict[tuple[str, tuple[str, ...]], StreetScene] = {}
        self._made: dict[tuple[str, tuple[str, ...], str], SensorRenderer] = {}
        self._meters: dict[tuple[str, tuple[str, ...]], CoverageMeter | None] = {}

    def street(self, arm: Arm, tracks: tuple[str, ...]) -> StreetScene:
        """The street of an arm; `tracks` are replaced where it replaces any."""
        key = arm.name, tracks
        if key not in self._streets:
            self._streets[key] = self._street_of(arm, tracks)
        return self._streets[key]

    def of(
        self,
        arm: Arm,
        tracks: tuple[str, ...],
        planner: str,
        mounts: Mapping[str, CameraMount],
    ) -> SensorRenderer:
        """The renderer of an arm.

        Args:
            planner: whose cameras are among `mounts`.
            tracks: whose vehicles are replaced where the arm does that, the target first.

        Raises:
            InputError: the street has no such actor, or the log is not synthetic.
        """
        key = arm.name, tracks, planner
        if key not in self._made:
            self._made[key] = self._make(arm, tracks, mounts)
        return self._made[key]

    def meter(self, arm: Arm, tracks: tuple[str, ...]) -> CoverageMeter | None:
        """What measures the coverage of an arm's target; None for a vehicle without shares."""
        if not arm.generates:
            return None
        key = arm.name, tracks
        if key not in self._meters:
            actor = self._actor_of(arm, tracks[0])
            self._meters[key] = (
                None
                if actor.shares is None
                else CoverageMeter(self.street(arm, tracks), actor.track_id, actor.shares)
            )
        return self._meters[key]

    def _make(
        self, arm: Arm, tracks: tuple[str, ...], mounts: Mapping[str, CameraMount]
    ) -> SensorRenderer:
        if not arm.is_truth:
            street = self.street(arm, tracks)
            return through_lenses(mounts, lambda pinholes: SceneRenderer(street, pinholes))
        from recast.simulation.oracle_renderer import OracleRenderer  # with the synthetic world

        world, keep = self._world_of(), self._open.enter_context
        return through_lenses(
            mounts, lambda pinholes: keep(OracleRenderer(world, pinholes, self._oracle_workers))
        )

    def close(self) -> None:
        """End the oracle's processes."""
        self._open.close()
