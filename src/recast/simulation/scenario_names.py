"""Scenario names: a motion and its setting, or a scenario file, as written on the command line."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path

from recast.core.arguments import checked
from recast.core.errors import InputError
from recast.simulation.actor_motion import AnyMotion, BaseMotion, whole_motion
from recast.simulation.scenario import Scenario, ScriptedMotion
from recast.simulation.scenario_file import read_scenario

_BUILT_IN = (
    "cut-in",
    "cut-in-stop",
    "oncoming",
    "oncoming-through",
    "stationary",
    "advancing",
    "log-replay",
    "idm",
)
_SUFFIXES = (".yaml", ".yml")


def scenario_name(motion: AnyMotion | Scenario) -> str:
    """Name such as "cut-in-a"; `parse_motions` reads it back where the motion is built in."""
    return f"{motion.name}-{motion.setting}"


def _built_in() -> dict[str, ScriptedMotion]:
    with as_file(files("recast.simulation") / "scenarios") as folder:
        motions = [m for name in _BUILT_IN for m in read_scenario(folder / f"{name}.yaml")]
    return {scenario_name(motion): motion for motion in motions}


MOTIONS: dict[str, ScriptedMotion] = _built_in()
"""The motions with their settings, by scenario name."""


def parse_motions(name: str) -> tuple[ScriptedMotion, ...]:
    """The motions that a word on the command line stands for.

    Args:
        name: a scenario such as "cut-in-b"; a motion, which stands for all its settings; or the
            path of a scenario file (with a slash, or ending in .yaml or .yml), likewise.

    Raises:
        InputError: no such motion (lists those there are), or a faulty file.
    """
    lowered = name.strip().lower()
    found = tuple(m for key, m in MOTIONS.items() if lowered in (key, m.name))
    if found:
        return found
    path = Path(name.strip())
    if "/" not in name and path.suffix.lower() not in _SUFFIXES:
        raise InputError(
            "motion",
            name,
            "is not known",
            f"choose one of {', '.join(MOTIONS)}, or a scenario file (.yaml)",
        )
    own = read_scenario(path)
    for motion in own:
        if scenario_name(motion) in MOTIONS:
            raise InputError(
                path,
                "name",
                f"{motion.name} with setting {motion.setting} is a built-in scenario",
                "choose another name or setting, so that results differ in name",
            )
    return own


@checked()
def motion(name: str | Path | AnyMotion | Scenario) -> BaseMotion | Scenario:
    """What an actor shall do, by name.

    Args:
        name: a scenario such as "cut-in-b"; a motion such as "cut-in", which stands for its first
            setting; the path of a scenario file, likewise; or a motion, which is returned
            with all members that it lacks.

    Raises:
        InputError: no such motion, a faulty file, or an object that is no motion.

    >>> motion("cut-in").setting
    'a'
    """
    if isinstance(name, str | Path):
        return parse_motions(str(name))[0]
    return name if isinstance(name, Scenario) else whole_motion(name)
