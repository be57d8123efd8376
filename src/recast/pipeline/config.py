"""What one run is asked to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from recast.actors import AUTO, DEFAULT_GENERATOR, DEFAULT_SEGMENTER
from recast.pipeline.arms import MOST_VIEWS, Arm, default_arms
from recast.planning import DEVICE_PATTERN
from recast.records import Record, parse_record
from recast.scene import Preset, SceneConfig
from recast.simulation import MOTIONS, ScriptedMotion, motion_of_record, scenario_name
from recast.storage import read_json

CONFIG_VERSION: Literal[2] = 2
"""1 had one planner, and methods instead of arms."""


class RunConfig(Record):
    """The resolved configuration of a run, as written to `run.json`.

    `motions` are scenario names with their setting, such as "cut-in-a"; `own_motions` holds those
    that came from scenario files, so that the run needs no file again. `arms` are what is compared,
    the first is the baseline; `generator`, `axes`, `refine`, `segmenter` and `views` are those of
    the arms that do not say otherwise. `streets` holds the settings of the streets that arms name
    beside the run's own, which are `scene`.
    """

    version: Literal[2] = Field(default=CONFIG_VERSION, description="version of this file's format")
    track: str = Field(description="id of the track to replace and control")
    motions: tuple[str, ...] = Field(
        min_length=1, description="scenario names with their setting, such as cut-in-a"
    )
    own_motions: dict[str, dict[str, Any]] = Field(
        default={}, description="contents of scenario files, by scenario name"
    )
    arms: tuple[Arm, ...] = Field(
        default_factory=default_arms,
        min_length=1,
        description="what is compared; the first is the baseline",
    )
    planners: tuple[str, ...] = Field(
        default=("idm-follower",),
        min_length=1,
        description="planners under test: names, folders or package.module:attribute",
    )
    planner_device: str = Field(
        default="auto",
        pattern=f"^({DEVICE_PATTERN})$",
        description="device of the planner: auto, cpu, cuda or cuda:1",
    )
    generator: str = Field(
        default=DEFAULT_GENERATOR,
        description=(
            "generator of vehicles: a name, a model folder, a vehicle file or library:FOLDER"
        ),
    )
    axes: str = Field(default=AUTO, description="axes of vehicle files or of a model folder")
    refine: bool = Field(
        default=True, description="whether actors are refined on all images of the log"
    )
    segmenter: str = Field(
        default=DEFAULT_SEGMENTER,
        description="segmenter of the target: a name, or the folder of its networks",
    )
    views: int = Field(
        default=1,
        ge=1,
        le=MOST_VIEWS,
        description="maximum number of views that an actor is made from",
    )
    steps: int = Field(
        default=160,
        ge=1,
        description="steps of 0.1 s for each rollout; fewer if the log or the road ends",
    )
    plan_every: int = Field(default=5, ge=1, description="steps between two plans")
    keep_other_actors: bool = Field(
        default=False, description="whether other recorded actors stay, with their recorded motion"
    )
    plan_limit_s: float | None = Field(
        default=None,
        gt=0,
        description="maximum wall-clock time of one plan, seconds; null: no limit",
    )
    films: bool = Field(
        default=True,
        description=(
            "whether all cameras are rendered and filmed; otherwise only the planner's are rendered"
        ),
    )
    seed: int = Field(default=0, description="seed of everything random")
    threads: int = Field(default=0, ge=0, le=1024, description="number of CPU threads; 0: all")
    preset: Preset | None = Field(
        default=None, description="method of the scene; it sets what `scene` does not name"
    )
    scene: SceneConfig = Field(
        default=SceneConfig(), description="settings of the run's own street"
    )
    scene_folder: str | None = Field(
        default=None, description="folder of a trained or imported scene; no scene is trained"
    )
    streets: dict[str, SceneConfig] = Field(
        default={}, description="settings of the presets that arms name"
    )

    @field_validator("own_motions")
    @classmethod
    def _own_motions_are_motions(cls, value: dict[str, dict[str, Any]]) -> dict[str, Any]:
        for name, record in value.items():
            described = scenario_name(motion_of_record(record))
            if name != described:  # names become folders; those of scenario files are plain words
                raise ValueError(f"{name!r} describes the scenario {described!r}")
        return value

    @field_validator("motions", "planners", "arms")
    @classmethod
    def _each_once(cls, value: tuple[Any, ...]) -> tuple[Any, ...]:
        names = [one.name if isinstance(one, Arm) else one for one in value]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"names {name!r} twice")
        return value

    @model_validator(mode="after")
    def _motions_are_known(self) -> Self:
        for name in self.motions:
            if name not in MOTIONS and name not in self.own_motions:
                raise ValueError(
                    f"motions: {name!r} is neither built in ({', '.join(MOTIONS)}) "
                    "nor in own_motions"
                )
        return self

    def motion(self, name: str) -> ScriptedMotion:
        """The motion of one of `motions`."""
        record = self.own_motions.get(name)
        return MOTIONS[name] if record is None else motion_of_record(record)

    def arm(self, name: str) -> Arm:
        """One of `arms`, with the run's settings where it has none of its own."""
        arm = next(arm for arm in self.arms if arm.name == name)
        if not arm.generates:
            return arm
        missing = [key for key in _OF_THE_RUN if getattr(arm, key) is None]
        return arm.model_copy(update={key: getattr(self, key) for key in missing})

    def street(self, name: str) -> SceneConfig:
        """The scene settings of a street that is to be trained."""
        return self.streets.get(name, self.scene)

    def resolved(self) -> dict[str, Any]:
        """JSON-able, every default filled in."""
        return self.model_dump(mode="json")


_OF_THE_RUN = ("generator", "axes", "refine", "segmenter", "views")


def read_run_config(path: str | Path) -> RunConfig:
    """Read a configuration file: the `config` member of a `run.json`, or the same by hand.

    Raises:
        InputError: missing, not JSON, of another version, or with a wrong field.
    """
    value = read_json(path)
    if isinstance(value, dict) and isinstance(value.get("config"), dict):
        value = value["config"]
    return parse_record(path, value, RunConfig, CONFIG_VERSION, "correct it, see docs/runs.md")
