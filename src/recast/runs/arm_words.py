"""Words and files on the command line that stand for arms; docs/runs.md#arms lists them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from recast.core import files
from recast.core.errors import InputError, nearest
from recast.core.plugins import GENERATORS
from recast.core.records import validated
from recast.core.yaml_lines import nodes_of, read_yaml_file
from recast.runs.arms import NOISES, OWN_STREET, PRESETS, TRUTH, Arm, default_arms
from recast.runs.paper import PAPER, paper_arms
from recast.scene.store import SCENE_FILE
from recast.weights import PUBLISHED

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
        return _read_arms(paper_arms())
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
