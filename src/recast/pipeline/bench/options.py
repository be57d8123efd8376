"""From a configuration file and options that override it to the settings of a grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from recast.errors import InputError
from recast.pipeline.bench.scenes import parse_scenes
from recast.pipeline.bench.settings import ANY_TRACK, BenchSettings, DriveSize
from recast.pipeline.options import resolve_config

MOTIONS = ("cut-in", "oncoming", "stationary")
"""The paper's, with both settings each."""

_QUICK_DRIVE = DriveSize(8.0, 192, 128)
_QUICK_RUN = {"steps": 40}
_QUICK_SCENE = {"cameras": ("front",), "iterations": 300}
_SCENE = {"scale": 1.0}


def resolve_bench(
    *,
    words: Sequence[str],
    track: str | None,
    motions: Sequence[str],
    quick: bool,
    config_file: Path | None,
    scene_config_file: Path | None,
    samples: int,
    drive_options: Mapping[str, Any],
    run_options: Mapping[str, Any],
    scene_options: Mapping[str, Any],
) -> BenchSettings:
    """Merge files and options; an option that is None was not given.

    Args:
        words, track: see `parse_scenes`.
        motions: names; none for the paper's.
        quick: small sizes where no option says otherwise.
        samples: of the bootstrap.

    Raises:
        InputError: a file, a scene or an option is wrong.
    """
    given = {name: value for name, value in drive_options.items() if value is not None}
    drive = replace(_QUICK_DRIVE if quick else DriveSize(), **given)
    if samples < 1:
        raise InputError("--samples", "value", f"is {samples}", "give 1 or more")
    files = config_file is not None or scene_config_file is not None
    scene_defaults = {**({} if files else _SCENE), **(_QUICK_SCENE if quick else {})}
    run = resolve_config(
        ANY_TRACK,
        tuple(motions) or MOTIONS,
        config_file,
        scene_config_file,
        _over(_QUICK_RUN if quick else {}, run_options),
        _over(scene_defaults, scene_options),
    )
    return BenchSettings(tuple(parse_scenes(words, run.seed, track)), run, drive, samples)


def _over(defaults: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, Any]:
    return {**defaults, **{k: v for k, v in options.items() if v is not None}}
