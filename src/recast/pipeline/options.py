"""Merge a configuration file and command-line options into one resolved configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from recast.errors import InputError
from recast.pipeline.arms import PRESETS, Arm, default_arms, is_street, parse_arms
from recast.pipeline.config import RunConfig, read_run_config
from recast.pipeline.paper import PAPER, paper_config
from recast.records import validation_error
from recast.scene import SceneConfig, read_config, read_training_config
from recast.scene import resolve_config as scene_config
from recast.scene.importers import IMPORT_FILE
from recast.simulation import MOTIONS, parse_motions, scenario_name, scenario_record

DEFAULT_MOTIONS = ("cut-in", "stationary")


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
        config_file = paper_config()
    base = None if config_file is None else read_run_config(config_file)
    names = tuple(motions) or (base.motions if base else DEFAULT_MOTIONS)
    values = {**(base.model_dump() if base else {}), **_given(run_options), "track": track}
    values |= _motions(names, base.own_motions if base else {})
    arms = parse_arms(run_options.get("arms") or ()) or (base.arms if base else default_arms())
    values["arms"] = arms
    try:
        return RunConfig.model_validate(
            {**values, **_scenes(values, arms, base, scene_config_file, scene_options)}
        )
    except ValidationError as error:
        raise validation_error("options", error, "give a value in range") from None


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
                "--scene", str(folder), f"is given beside the preset {presets[0]}",
                f"name it as an arm instead: --arm {folder}",
            )  # fmt: skip
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
    "cameras", "scale", "iterations", "seed", "threads", "holdout_every", "holdout_offset",
    "force_dynamic", "exclude_tracks",
)  # fmt: skip


def _of_folder(folder: str, options: Mapping[str, Any]) -> SceneConfig:
    """The training settings of a scene; for an imported scene, the settings of its images.

    Raises:
        InputError: no scene lies there, or an option would need another training.
    """
    if not is_street(folder) or not Path(folder).is_dir():
        raise InputError(folder, "--scene", "holds no scene", "name the folder of one")
    if (Path(folder) / IMPORT_FILE).is_file():
        return scene_config(None, SceneConfig(), options)
    found = read_training_config(folder)
    for name, value in options.items():
        if value is not None and name != "threads" and getattr(found, name) != value:
            raise InputError(
                folder, name, f"is {getattr(found, name)} of this trained scene, not {value}",
                f"leave --{name} out, or train another scene",
            )  # fmt: skip
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
                    name, "name", f"{scenario} is another scenario already", "choose another name"
                )
    return {
        "motions": tuple(found),
        "own_motions": {name: record for name, record in found.items() if record is not None},
    }


def _given(options: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}
