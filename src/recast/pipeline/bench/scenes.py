"""The scenes of a grid, as written on the command line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from recast.errors import InputError
from recast.logs import read_log
from recast.names import folder_name
from recast.pipeline.paper import AUTO_TRACK, choose_target
from recast.synthetic import SCENES

ALL_SYNTHETIC = "synthetic"
"""The word for every synthetic scene."""


@dataclass(frozen=True)
class BenchScene:
    """A scene of a grid.

    Attributes:
        id: its name in results and its folder below OUT/scenes.
        world, seed: of a synthetic one, else None.
        log, track: of a recorded one, else None.
    """

    id: str
    world: str | None = None
    seed: int | None = None
    log: Path | None = None
    track: str | None = None


def parse_scenes(words: Sequence[str], seed: int, track: str | None = None) -> list[BenchScene]:
    """The scenes that words stand for, in their order.

    Args:
        words: a synthetic scene, such as "urban-straight" or "urban-straight:3" with its seed; the
            word "synthetic", for all of them; a log folder with its target, LOG:TRACK; or a log
            folder alone, if `track` is given.
        seed: of synthetic scenes without one.
        track: of log folders without one. The track `auto` is the one that `choose_target`
            chooses.

    Raises:
        InputError: no scene; an unknown one; a log that cannot be read or lacks the track; the same
            scene twice.
    """
    scenes = [scene for word in words for scene in _parse(word, seed, track)]
    if not scenes:
        raise InputError("--scenes", "value", "names none", f"choose of {', '.join(SCENES)}")
    seen: set[str] = set()
    for scene in scenes:
        if scene.id in seen:
            raise InputError("--scenes", scene.id, "is named twice", "name each scene once")
        seen.add(scene.id)
    return scenes


def _parse(word: str, seed: int, track: str | None) -> list[BenchScene]:
    if word == ALL_SYNTHETIC:
        return [_synthetic(name, seed) for name in SCENES]
    name, colon, rest = word.rpartition(":")
    if not colon:
        name, rest = word, ""
    if name in SCENES:
        if colon and not re.fullmatch(r"[0-9]+", rest):
            problem = f"{rest!r} is no seed"
            raise InputError("--scenes", word, problem, "give a number, 0 or more")
        return [_synthetic(name, int(rest) if colon else seed)]
    # a whole word that is a folder wins, since paths may hold colons
    if Path(word).is_dir() and track is not None:
        return [_recorded(Path(word), track)]
    if colon and Path(name).is_dir():
        return [_recorded(Path(name), rest)]
    if Path(word).is_dir():
        raise InputError(
            "--scenes", word, "names no track to control", "write LOG:TRACK, or give --track"
        )
    raise InputError(
        "--scenes", word, "is neither a synthetic scene nor a log folder",
        f"choose of {', '.join(SCENES)}, say {ALL_SYNTHETIC} for all, or give LOG:TRACK",
    )  # fmt: skip


def _synthetic(name: str, seed: int) -> BenchScene:
    return BenchScene(f"{name}-{seed}", world=name, seed=seed)


def _recorded(path: Path, track: str) -> BenchScene:
    log = read_log(path)
    if track == AUTO_TRACK:
        track = choose_target(log)
    if track not in log.tracks:
        raise InputError(
            path, f"track {track}", "is not in the log", f"choose one of {', '.join(log.tracks)}"
        )
    return BenchScene(folder_name(f"{log.name}-{track}"), log=path, track=track)
