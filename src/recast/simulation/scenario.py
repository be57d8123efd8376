"""Scenario names: a motion and its setting, as written on the command line."""

from __future__ import annotations

from recast.errors import InputError
from recast.simulation.motions import ActorMotion, Advancing, CutIn, Oncoming, Stationary

_MOTIONS: tuple[ActorMotion, ...] = (
    CutIn("a", gap=6.0, initial_speed=0.8, target_speed=0.5, delay=0.5, duration=2.5),
    CutIn("b", gap=12.0, initial_speed=0.7, target_speed=0.35, delay=1.0, duration=3.0),
    Oncoming("a", gap=35.0, speed=3.0, stop_distance=15.0),
    Oncoming("b", gap=55.0, speed=6.0, stop_distance=25.0, lateral=0.3),
    Oncoming("a", gap=35.0, speed=3.0, stop_distance=15.0, mode="through"),
    Oncoming("b", gap=55.0, speed=6.0, stop_distance=25.0, lateral=0.3, mode="through"),
    Stationary("a", min_gap=20.0, braking=3.6, reserve=4.0),
    Stationary("b", min_gap=35.0, braking=2.4, reserve=6.0, yaw=0.17, lateral=0.3),
    Advancing("a", gap=5.0, speed=0.5),
    Advancing("b", gap=12.0, speed=0.65),
)


def scenario_name(motion: ActorMotion) -> str:
    """Name such as "cut-in-a"; `parse_motions` reads it back."""
    return f"{motion.name}-{motion.setting}"


MOTIONS: dict[str, ActorMotion] = {scenario_name(motion): motion for motion in _MOTIONS}
"""The motions with their two settings each, by scenario name."""


def parse_motions(name: str) -> tuple[ActorMotion, ...]:
    """The motion of a scenario name such as "cut-in-b"; of a motion's name, all its settings.

    Raises:
        InputError: no such motion; lists those there are.
    """
    lowered = name.strip().lower()
    found = tuple(m for key, m in MOTIONS.items() if lowered in (key, m.name))
    if not found:
        raise InputError("motion", name, "is not known", f"choose one of {', '.join(MOTIONS)}")
    return found
