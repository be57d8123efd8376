"""From a configuration file and options that override it to one resolved configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from recast.errors import InputError
from recast.pipeline.config import RunConfig, read_run_config
from recast.records import validation_error
from recast.scene import SceneConfig, read_config
from recast.scene import resolve_config as scene_config
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
    """Merge files and options; an option that is None was not given.

    The target is always modelled as an actor, however little it moved, or it could not be replaced.

    Raises:
        InputError: a file or an option is wrong.
    """
    base = None if config_file is None else read_run_config(config_file)
    names = tuple(motions) or (base.motions if base else DEFAULT_MOTIONS)
    written = base.scene if base else SceneConfig()
    if scene_config_file is not None:
        written = read_config(scene_config_file)
    known = base.preset if base else None
    preset = run_options.get("preset") or known
    # The record of a run holds all that its preset set.
    sets = None if preset == known and written.is_whole() else preset
    force_dynamic = tuple(dict.fromkeys((*written.force_dynamic, track)))
    scene = scene_config(sets, written, {**scene_options, "force_dynamic": force_dynamic})
    values = {
        **(base.model_dump() if base else {}),
        **_given(run_options),
        "track": track,
        **_motions(names, base.own_motions if base else {}),
        "scene": scene,
    }
    try:
        return RunConfig.model_validate(values)
    except ValidationError as error:
        raise validation_error("options", error, "give a value in range") from None


def _motions(names: Sequence[str], known: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """`motions` and `own_motions`; `known` are those that a configuration file brings along."""
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
