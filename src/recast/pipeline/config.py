"""What one run is asked to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from recast.actors import AUTO, DEFAULT_GENERATOR, DEFAULT_SEGMENTER
from recast.pipeline.layout import Method
from recast.pipeline.run_folder import RUN_FILE, RunFolder
from recast.planning import DEVICE_PATTERN
from recast.records import Record, parse_record
from recast.scene import Preset, SceneConfig
from recast.simulation import MOTIONS, ScriptedMotion, motion_of_record, scenario_name
from recast.storage import read_json

CONFIG_VERSION: Literal[1] = 1
MOST_VIEWS = 24
"""Of a target: one every 15 degrees all around."""


class RunConfig(Record):
    """The resolved configuration of a run, as written to `run.json`.

    `motions` are scenario names with their setting, such as "cut-in-a"; `own_motions` holds those
    that came from scenario files, so that the run needs no file again. `methods` say what renders
    the scene; the first is the baseline. "oracle" needs a synthetic log.
    """

    version: Literal[1] = CONFIG_VERSION
    track: str
    motions: tuple[str, ...] = Field(min_length=1)
    own_motions: dict[str, dict[str, Any]] = Field(
        default={}, description="contents of scenario files, by scenario name"
    )
    methods: tuple[Method, ...] = Field(default=("native", "replaced"), min_length=1)
    planner: str = "idm-follower"
    planner_device: str = Field(
        default="auto", pattern=f"^({DEVICE_PATTERN})$", description="where the planner computes"
    )
    generator: str = Field(
        default=DEFAULT_GENERATOR,
        description="generator, model folder, vehicle file or library:FOLDER",
    )
    axes: str = Field(default=AUTO, description="axis convention of vehicle files or a model")
    refine: bool = Field(default=True, description="follow all images of the log with the actor")
    segmenter: str = Field(
        default=DEFAULT_SEGMENTER, description="name of a segmenter, or folder of its networks"
    )
    views: int = Field(
        default=1, ge=1, le=MOST_VIEWS, description="most views of the target an actor is made from"
    )
    steps: int = Field(default=160, ge=1, description="of 0.1 s; cut where log or road end")
    plan_every: int = Field(default=5, ge=1)
    keep_other_actors: bool = False
    plan_limit_s: float | None = Field(
        default=None, gt=0, description="wall-clock seconds that a plan may take"
    )
    films: bool = Field(
        default=True, description="of all cameras; without, only what the planner sees is rendered"
    )
    seed: int = 0
    threads: int = Field(default=0, ge=0, le=1024, description="CPU threads, 0: all")
    preset: Preset | None = Field(
        default=None, description="method of the scene: sets what `scene` does not name"
    )
    scene: SceneConfig = SceneConfig()

    @field_validator("own_motions")
    @classmethod
    def _own_motions_are_motions(cls, value: dict[str, dict[str, Any]]) -> dict[str, Any]:
        for name, record in value.items():
            described = scenario_name(motion_of_record(record))
            if name != described:  # names become folders; those of scenario files are plain words
                raise ValueError(f"{name!r} describes the scenario {described!r}")
        return value

    @field_validator("motions", "methods")
    @classmethod
    def _each_once(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            if value.count(name) > 1:
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

    def resolved(self) -> dict[str, Any]:
        """JSON-able, every default filled in but those of the youngest members."""
        values = self.model_dump(mode="json")
        if self.preset is None:  # else a default may be a choice against the preset
            del values["preset"]
            values["scene"] = self.scene.resolved()
        if not self.own_motions:
            del values["own_motions"]  # runs begun before there were scenario files go on
        if self.axes == AUTO:
            del values["axes"]
        if self.views == 1:
            del values["views"]
        if self.planner_device == "auto":
            del values["planner_device"]
        if self.plan_limit_s is None:
            del values["plan_limit_s"]
        for default in ("films", "refine"):
            if values[default]:
                del values[default]
        return values


def config_of(folder: RunFolder) -> RunConfig:
    """The configuration of a run folder.

    Raises:
        InputError: its record was damaged.
    """
    mend = "run again into a new folder"
    return parse_record(
        folder.path / RUN_FILE, folder.record.config, RunConfig, CONFIG_VERSION, mend
    )


def read_run_config(path: str | Path) -> RunConfig:
    """Read a configuration file: the `config` member of a `run.json`, or the same by hand.

    Raises:
        InputError: missing, not JSON, of another version, or with a wrong field.
    """
    value = read_json(path)
    if isinstance(value, dict) and isinstance(value.get("config"), dict):
        value = value["config"]
    return parse_record(path, value, RunConfig, CONFIG_VERSION, "correct it, see docs/runs.md")
