"""What one run is asked to do: a configuration file, and command-line options over it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, ValidationError, field_validator, model_validator

from recast.actors import AUTO, DEFAULT_GENERATOR, DEFAULT_SEGMENTER
from recast.core.errors import InputError
from recast.core.files import read_json
from recast.core.records import Record, parse_record, validation_error
from recast.planning import DEVICE_PATTERN
from recast.reconstruction import resolve_config as scene_config
from recast.reconstruction.config import Preset, SceneConfig, read_config
from recast.reconstruction.train import read_training_config
from recast.runs.arms import (
    MOST_VIEWS,
    PAPER,
    PAPER_FOLDER,
    PRESETS,
    Arm,
    default_arms,
    is_street,
    parse_arms,
    require_undisturbed,
)
from recast.scene.exchange import IMPORT_FILE
from recast.simulation import (
    MOTIONS,
    ScriptedMotion,
    motion_of_record,
    parse_motions,
    scenario_name,
    scenario_record,
)
from recast.simulation.setup import TrafficKind

CONFIG_VERSION: Literal[2] = 2
DEFAULT_MOTIONS = ("cut-in", "stationary")


class RunConfig(Record):
    """The resolved configuration of a run, as written to `run.json`.

    `own_motions` holds the motions that came from scenario files, so that the run needs no file
    again. `streets` holds the settings of the streets that arms name beside the run's own.
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
        description="arms to compare; the first is the baseline",
    )
    planners: tuple[str, ...] = Field(
        default=("gtrs-mini",),
        min_length=1,
        description="planners under test: names, folders, package.module:attribute, "
        "alpasim:HOST:PORT or neuroncap:HOST:PORT",
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
    complete: tuple[str, ...] = Field(
        default=(),
        description=(
            "road users beside the target that are made complete, too: all, near (within 30 m of "
            "the recorded ego), or track ids"
        ),
    )
    traffic: TrafficKind = Field(
        default="none",
        description=(
            "what other recorded road users do: none takes them out, replay leaves them on their "
            "recorded motion, idm lets them give way on their recorded paths"
        ),
    )
    plan_limit_s: float | None = Field(
        default=None,
        gt=0,
        description="maximum wall-clock time of one plan, seconds; null: no limit",
    )
    end_on_contact: bool = Field(
        default=False,
        description="whether rollouts end with the first contact, for searches",
    )
    films: bool = Field(
        default=True,
        description=(
            "whether all cameras are rendered and filmed; otherwise only the planner's are rendered"
        ),
    )
    restorer: str | None = Field(
        default=None,
        description=(
            "restorer of the rendered images: harmonizer:HOST:PORT, a name or "
            "package.module:attribute; null: none. Images of the truth are never restored"
        ),
    )
    metrics: tuple[str, ...] = Field(
        default=(),
        description="own metrics beside recast's: names, or package.module:attribute",
    )
    seed: int = Field(default=0, description="seed of everything random")
    threads: int = Field(default=0, ge=0, le=1024, description="number of CPU threads; 0: all")
    preset: Preset | None = Field(
        default=None,
        description="method of the scene; it sets all settings that `scene` leaves out",
    )
    scene: SceneConfig = Field(
        default=SceneConfig(), description="settings of the run's own street"
    )
    scene_folder: str | None = Field(
        default=None,
        description="folder of a trained or imported scene, used in place of training one",
    )
    streets: dict[str, SceneConfig] = Field(
        default={}, description="settings of the presets that arms name"
    )

    @model_validator(mode="before")
    @classmethod
    def _as_written_now(cls, value: Any) -> Any:
        return as_written_now(value) if isinstance(value, dict) else value

    @field_validator("own_motions")
    @classmethod
    def _own_motions_are_motions(cls, value: dict[str, dict[str, Any]]) -> dict[str, Any]:
        for name, record in value.items():
            described = scenario_name(motion_of_record(record))
            if name != described:  # names become folders; those of scenario files are plain words
                raise ValueError(f"the key {name!r} holds the scenario {described!r}")
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
        """JSON-able, every default filled in.

        Members that only some runs set are not there in others, so that older runs can be gone on
        with.
        """
        some = ("restorer", "end_on_contact", "metrics", "complete")
        unset = {name for name in some if not getattr(self, name)}
        if self.traffic == "none":
            unset.add("traffic")
        return self.model_dump(mode="json", exclude=unset)


def as_written_now(config: dict[str, Any]) -> dict[str, Any]:
    """A configuration of a run with its members as they are called now: what is `traffic` was
    `keep_other_actors`."""
    if "keep_other_actors" not in config:
        return config
    kept = {name: value for name, value in config.items() if name != "keep_other_actors"}
    return {**kept, "traffic": "replay"} if config["keep_other_actors"] is True else kept


_OF_THE_RUN = ("generator", "axes", "refine", "segmenter", "views")


def read_run_config(path: str | Path) -> RunConfig:
    """Read a configuration file: the `config` member of a `run.json`, or the same by hand.

    Raises:
        InputError: missing, not JSON, of another version, or with a wrong field.
    """
    value = read_json(path)
    if isinstance(value, dict) and isinstance(value.get("config"), dict):
        value = value["config"]
    return parse_record(
        path, value, RunConfig, CONFIG_VERSION, "correct it; see docs/runs.md#a-configuration-file"
    )


def resolve_config(
    track: str,
    motions: Sequence[str],
    config_file: Path | None,
    scene_config_file: Path | None,
    run_options: Mapping[str, Any],
    scene_options: Mapping[str, Any],
) -> RunConfig:
    """Merge files and options; the value None means that an option was not given.

    Args:
        run_options: values of `RunConfig` by member; `arms` are words, see `parse_arms`.
        scene_options: values of `SceneConfig` by member.

    Raises:
        InputError: a file or an option is wrong.
    """
    if config_file is not None and str(config_file) == PAPER:
        # Three forward cameras of 960x640, 30,000 steps, GTRS-Dense, K = 5.
        config_file = PAPER_FOLDER / "config.json"
    base = None if config_file is None else read_run_config(config_file)
    names = tuple(motions) or (base.motions if base else DEFAULT_MOTIONS)
    values = {**(base.model_dump() if base else {}), **given(run_options), "track": track}
    values |= _motions(names, base.own_motions if base else {})
    arms = parse_arms(run_options.get("arms") or ()) or (base.arms if base else default_arms())
    require_undisturbed(arms)
    values["arms"] = arms
    try:
        return RunConfig.model_validate(
            {**values, **_scenes(values, arms, base, scene_config_file, scene_options)}
        )
    except ValidationError as error:
        fields = {**RunConfig.model_fields, **SceneConfig.model_fields}
        raise validation_error("options", error, "give a value in range", fields) from None


def _scenes(
    values: Mapping[str, Any],
    arms: Sequence[Arm],
    base: RunConfig | None,
    file: Path | None,
    options: Mapping[str, Any],
) -> dict[str, Any]:
    """`scene` (settings of the run's own street) and `streets` (settings of the arms' presets)."""
    folder = values.get("scene_folder")
    if folder is not None:
        scene = _of_folder(folder, options)
        presets = [name for name in PRESETS if any(arm.street == name for arm in arms)]
        if presets:
            raise InputError(
                "`scene`",
                str(folder),
                f"is given together with the preset {presets[0]}",
                f"give the folder as an arm instead: `arm` {folder}",
                "docs/runs.md#arms",
            )
        return {"scene": scene, "streets": {}}
    written = base.scene if base else SceneConfig()
    if file is not None:
        written = read_config(file)
    preset, known = values.get("preset"), base.preset if base else None
    # The record of a run holds all that its preset set.
    scene = scene_config(
        None if preset == known and written.is_whole() else preset, written, options
    )
    streets = dict(base.streets) if base else {}
    for name in PRESETS:
        if name not in streets and any(arm.street == name for arm in arms):
            # Of the run's own settings a preset keeps what is not the method's.
            kept = {key: getattr(scene, key) for key in _SHARED}
            streets[name] = scene_config(name, None, {**kept, **options})
    return {"scene": scene, "streets": streets}


_SHARED = (
    "cameras",
    "scale",
    "iterations",
    "seed",
    "threads",
    "holdout_every",
    "holdout_offset",
    "force_dynamic",
    "exclude_tracks",
)


def _of_folder(folder: str, options: Mapping[str, Any]) -> SceneConfig:
    """The training settings of a scene; for an imported scene, the settings of its images.

    Raises:
        InputError: no scene lies there, or an option would need another training.
    """
    if not is_street(folder) or not Path(folder).is_dir():
        raise InputError(
            folder, "`scene`", "is not a scene folder", "name a scene folder", "docs/runs.md#arms"
        )
    if (Path(folder) / IMPORT_FILE).is_file():
        return scene_config(None, SceneConfig(), options)
    found = read_training_config(folder)
    for name, value in options.items():
        if value is not None and name != "threads" and getattr(found, name) != value:
            raise InputError(
                folder,
                name,
                f"is {getattr(found, name)} in this trained scene, not {value}",
                f"leave `{name}` out, or train another scene",
                "docs/scenes.md#configuration",
            )
    return found


def _motions(names: Sequence[str], known: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """`motions` and `own_motions`; `known` are the motions of a configuration file."""
    found: dict[str, dict[str, Any] | None] = {}
    for name in names:
        if name in known:
            found[name] = known[name]
            continue
        for motion in parse_motions(name):
            scenario = scenario_name(motion)
            record = None if scenario in MOTIONS else scenario_record(motion)
            if found.setdefault(scenario, record) != record:
                raise InputError(
                    name,
                    "name",
                    f"another scenario is already called {scenario}",
                    "choose another name",
                    "docs/scenarios.md#your-own-as-a-file",
                )
    return {
        "motions": tuple(found),
        "own_motions": {name: record for name, record in found.items() if record is not None},
    }


def given(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are not None."""
    return {name: value for name, value in options.items() if value is not None}
