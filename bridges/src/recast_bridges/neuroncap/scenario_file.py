"""NeuroNCAP's scenario files, read with every member checked; an error names file, line and key.

Only plain data is read (see `recast.simulation.yaml_lines`). Keys may have hyphens or underscores.
Members that NeuroNCAP's code does not look at are checked and not used: `smooth-actors`, and
`times` of a jitter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

from recast.core.errors import InputError
from recast.core.yaml_lines import YamlNode, read_yaml_file
from recast.logs.checks import WORLD_REACH, check_name

_LARGEST_FILE = 1_000_000
_MOST_ACTORS = 100
_MEND = "correct it as in NeuroNCAP's own scenarios"
_PLAN_INTERVAL = 0.5
_MOST_SAMPLES = 1000
_SHORTEST = 1e-3
"""Seconds between two times of a path."""
_GENERAL = (
    "start_frame", "priming_steps", "time_step", "duration", "dim_jitter", "start_jitter",
    "start_pose", "start_velo", "smooth_actors", "actor_framerate",
)  # fmt: skip
_ACTOR = (
    "mode", "uuid", "uuids", "flip_uuids", "exclusive_group", "times", "positions", "initial_yaw",
    "dims", "is_target_actor", "jitter",
)  # fmt: skip
_JITTER = ("longitudinal", "lateral", "long_lat_angle", "yaw_jitter", "uniform", "times")


@dataclass(frozen=True)
class Jitter:
    """How far the places and the yaw of an actor are moved at random."""

    # longitudinal, lateral: metres, along `angle` and to its right; None for none.
    longitudinal: float | None
    lateral: float | None
    angle: float  # radians, in the coordinates of the dataset
    yaw: float | None  # radians; None for none
    uniform: bool  # whether they are bounds of a uniform draw; else standard deviations


@dataclass(frozen=True)
class NcapFileActor:
    """An actor of a scenario."""

    uuids: tuple[str, ...]  # tracks of which one is drawn for each run
    is_list: bool  # whether the file gives a list, for which a random number is drawn
    flipped: tuple[str, ...]  # tracks whose fallback yaw is turned by pi
    group: str | None  # group of which only one actor is in a run; None for none
    optimized: bool  # drives as logged; otherwise it is at `positions` at `times`
    times: tuple[float, ...]  # seconds after the first key frame
    # x, y, z in the coordinates of the dataset, bottom of the box.
    positions: tuple[tuple[float, float, float], ...]
    yaw: float  # radians, for where it stands
    target: bool
    jitter: Jitter | None


@dataclass(frozen=True)
class NcapScenario:
    """A scenario; frames are key frames, two a second.

    Attributes:
        priming_steps: frames after the start during which the ego drives as logged.
        duration: seconds from the start frame.
        start_jitter: frames by which the start is moved at random.
        framerate: 1/s at which the paths of actors are sampled.
    """

    start_frame: int
    priming_steps: int
    duration: float
    start_jitter: int
    framerate: float
    actors: tuple[NcapFileActor, ...]


def read_ncap_scenario(path: str | Path) -> NcapScenario:
    """A scenario file of NeuroNCAP.

    Raises:
        InputError: the file cannot be read, or a member is missing, unknown, out of range, or asks
            for what recast does not do: other sizes of vehicles, plans at another interval than
            0.5 s, and starts that are not the log's.
    """
    root = _Members(read_yaml_file(path, _LARGEST_FILE), ("general", "actors"))
    general = _Members(root.required("general"), _GENERAL)
    for key in ("start_pose", "start_velo"):
        general.word(key, ("original",), "original")
    general.flag("smooth_actors", True)
    if general.number("time_step", 0.0, 1e3, 0.5) != _PLAN_INTERVAL:
        raise general.fault("time_step", None, "give 0.5: recast plans every 0.5 s")
    if general.number("dim_jitter", 0.0, 1.0, 0.0) != 0.0:
        raise general.fault("dim_jitter", None, "give 0: vehicles keep their size")
    duration = general.number("duration", 0.5, 1000.0, 20.0)
    framerate = general.number("actor_framerate", 0.1, 100.0, 2.0)
    if not 2 <= int(duration * framerate) <= _MOST_SAMPLES:
        mend = f"give a rate of 2 to {_MOST_SAMPLES} samples in the duration"
        raise general.fault("actor_framerate", None, mend)
    listed = root.required("actors")
    if not isinstance(listed.value, list) or not 0 < len(listed.value) <= _MOST_ACTORS:
        raise listed.error("actors", None, f"give a list of 1 to {_MOST_ACTORS} actors")
    return NcapScenario(
        start_frame=general.whole("start_frame", 0),
        priming_steps=general.whole("priming_steps", 1),
        duration=duration,
        start_jitter=general.whole("start_jitter", 0),
        framerate=framerate,
        actors=tuple(_actor(_Members(one, _ACTOR)) for one in listed.value),
    )


class _Members:
    """The members of a mapping by their names with underscores; all must be known."""

    def __init__(self, node: YamlNode, known: tuple[str, ...]) -> None:
        if not isinstance(node.value, dict):
            raise node.error(known[0], None, f"give the keys {', '.join(known)}")
        self._node = node
        self._found: dict[str, YamlNode] = {}
        for written, member in node.value.items():
            key = written.replace("-", "_")
            if key not in known:
                near = get_close_matches(key, known, 1)
                mend = f"did you mean {near[0]}?" if near else f"choose one of {', '.join(known)}"
                raise member.error(written, "is not known", mend)
            if key in self._found:
                raise member.error(written, "is given twice", "remove one of them")
            self._found[key] = member

    def __contains__(self, key: str) -> bool:
        return key in self._found

    def required(self, key: str) -> YamlNode:
        if key not in self._found:
            raise self._node.error(key, "is missing", _MEND)
        return self._found[key]

    def fault(self, key: str, problem: str | None, mend: str) -> InputError:
        return self._found.get(key, self._node).error(key, problem, mend)

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        if default is not None and key not in self._found:
            return default
        return _number(self.required(key), key, low, high)

    def whole(self, key: str, default: int) -> int:
        value = self.number(key, 0, 10_000, default)
        if value != int(value):
            raise self.fault(key, None, "give a whole number")
        return int(value)

    def flag(self, key: str, default: bool) -> bool:
        value = self._found[key].value if key in self._found else default
        if not isinstance(value, bool):
            raise self.fault(key, None, "write true or false")
        return value

    def word(self, key: str, known: tuple[str, ...], default: str | None = None) -> str:
        if default is not None and key not in self._found:
            return default
        value = self.required(key).value
        if not isinstance(value, str) or value not in known:
            raise self.fault(key, None, f"give {' or '.join(known)}")
        return value

    def several(self, key: str, least: int, read: Callable[[YamlNode], Any]) -> tuple[Any, ...]:
        node = self.required(key)
        if not isinstance(node.value, list) or len(node.value) < least:
            raise node.error(key, None, f"give a list of {least} or more entries")
        return tuple(read(one) for one in node.value)


def _number(node: YamlNode, key: str, low: float, high: float) -> float:
    if not isinstance(node.value, float) or not low <= node.value <= high:
        raise node.error(key, None, f"give a number from {low:g} to {high:g}")
    return node.value


def _uuid(node: YamlNode) -> str:
    try:
        check_name("uuid", node.value)
    except ValueError:
        raise node.error("uuid", None, "give a track id, in quotes if it is all digits") from None
    uuid: str = node.value
    return uuid


def _place(node: YamlNode) -> tuple[float, ...]:
    if not isinstance(node.value, list) or len(node.value) != 3:
        raise node.error("positions", None, "give x, y and z in metres for each time")
    return tuple(_number(one, "positions", -WORLD_REACH, WORLD_REACH) for one in node.value)


def _actor(one: _Members) -> NcapFileActor:
    optimized = one.word("mode", ("override", "optimized")) == "optimized"
    if ("uuid" in one) == ("uuids" in one):
        raise one.fault("uuids", "must be given, or uuid, but not both", _MEND)
    if "dims" in one:
        raise one.fault("dims", None, "leave it out: vehicles keep their size")
    uuids = one.several("uuids", 1, _uuid) if "uuids" in one else (_uuid(one.required("uuid")),)
    flipped = one.several("flip_uuids", 0, _uuid) if "flip_uuids" in one else ()
    times: tuple[float, ...] = ()
    positions: tuple[tuple[float, float, float], ...] = ()
    if not optimized:
        times = one.several("times", 2, lambda node: _number(node, "times", -1000.0, 1000.0))
        positions = one.several("positions", 2, _place)
        if len(times) != len(positions):
            problem = f"has {len(positions)} positions for {len(times)} times"
            raise one.fault("positions", problem, _MEND)
        if any(later - earlier < _SHORTEST for earlier, later in pairwise(times)):
            raise one.fault("times", f"do not increase by {_SHORTEST:g} s or more", _MEND)
    return NcapFileActor(
        uuids=uuids,
        is_list="uuids" in one,
        flipped=flipped,
        group=_group(one),
        optimized=optimized,
        times=times,
        positions=positions,
        yaw=one.number("initial_yaw", -10.0, 10.0, 0.0),
        target=one.flag("is_target_actor", False),
        jitter=_jitter(_Members(one.required("jitter"), _JITTER)) if "jitter" in one else None,
    )


def _group(one: _Members) -> str | None:
    """NeuroNCAP takes an empty group, or 0, for none."""
    if "exclusive_group" not in one:
        return None
    value = one.required("exclusive_group").value
    if not isinstance(value, str | float):
        raise one.fault("exclusive_group", None, "give a text or a number")
    return str(value) if value else None


def _jitter(one: _Members) -> Jitter:
    known: Mapping[Literal["longitudinal", "lateral", "yaw_jitter"], float | None] = {
        "longitudinal": one.number("longitudinal", 0.0, 1000.0) if "longitudinal" in one else None,
        "lateral": one.number("lateral", 0.0, 1000.0) if "lateral" in one else None,
        "yaw_jitter": one.number("yaw_jitter", 0.0, 10.0) if "yaw_jitter" in one else None,
    }
    moved = known["longitudinal"] is not None or known["lateral"] is not None
    if moved and "long_lat_angle" not in one:
        raise one.fault("long_lat_angle", "is missing", "give the angle of the longitudinal axis")
    if "times" in one:
        one.several("times", 0, lambda node: _number(node, "times", 0.0, 1000.0))
    return Jitter(
        known["longitudinal"],
        known["lateral"],
        one.number("long_lat_angle", -10.0, 10.0, 0.0),
        known["yaw_jitter"],
        one.flag("uniform", True),
    )
