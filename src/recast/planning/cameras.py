"""Which cameras are rendered for a planner: only those it looks at, and virtual ones.

In the closed loop every image is rendered, so a picture of another size, field of view or direction
is one more camera to render. What no camera of the log looks at is black in it: the reconstruction
there is a guess, which a planner must not take for the street.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from recast.cameras import CameraMount
from recast.cameras.mounts import (
    WITHIN_DEGREES,
    Look,
    choose_views,
    directions,
    match_cameras,
    nuplan_rig,
    seen_by,
)
from recast.core.errors import InputError
from recast.core.foreign import whole
from recast.planning.types import BasePlanner, Planner

NEEDED = 0.5
"""Share of a picture ahead that the log's cameras must see; nobody can drive by less."""

ENOUGH = 0.9
"""Share of any picture below which the user is warned."""

_AHEAD = Look.level(0.0, 60.0)


def planner_cameras(
    planner: Planner, mounts: Mapping[str, CameraMount], otherwise: Iterable[str] | None = None
) -> tuple[str, ...]:
    """Names of the cameras to render for a planner: the values of `camera_choice`."""
    return tuple(camera_choice(planner, mounts, otherwise).values())


def camera_choice(
    planner: Planner, mounts: Mapping[str, CameraMount], otherwise: Iterable[str] | None = None
) -> dict[str, str]:
    """What the planner calls its cameras, and which ones are rendered for that.

    In this order: none if it needs no images; what its method `choose_cameras(mounts)` returns,
    names or a mapping to names, which are its `camera_names` unless it has a method of its own;
    `otherwise`.

    Args:
        otherwise: names of cameras for planners that do not say; None for all.

    Raises:
        InputError: a camera is not there; or what `choose_cameras` raises.
    """
    if not planner.needs_images:
        return {}
    names = whole(planner, BasePlanner).choose_cameras(mounts)
    if names is None:
        names = tuple(mounts if otherwise is None else otherwise)
    choice = dict(names) if isinstance(names, Mapping) else {name: name for name in names}
    require_cameras(choice.values(), mounts, f"planner {planner.name}")
    return choice


def require_cameras(names: Iterable[str], there: Mapping[str, object], where: str) -> None:
    """Raise an InputError that names the first missing camera, and `where`, who wants it."""
    for name in names:
        if name not in there:
            raise InputError(
                where,
                f"camera {name}",
                "is needed but missing",
                f"render it, or name other cameras; there are {', '.join(there) or 'none'}",
            )


def virtual_mounts(
    planner: Planner, mounts: Mapping[str, CameraMount], scale: float = 1.0
) -> dict[str, CameraMount]:
    """The virtual cameras to render for a planner beside the log's, by names that are not taken.

    One for each of its `wanted_views` that no camera shows as it is: with the intrinsics and
    direction of the view, at the place of the camera that stands for it (see `match_cameras`), or
    of the one that sees most of it. And those cameras of `nuplan_rig` that the planner names.
    """
    planner = whole(planner, BasePlanner)
    views, rig = planner.wanted_views, nuplan_rig(scale)
    made = {
        name: replace(rig[name], seen=seen_by(rig[name], mounts.values()))
        for name in planner.camera_names or ()
        if name in rig and name not in mounts
    }
    chosen = choose_views(views, mounts)
    missing = {view.name: view for view in views if view.name not in chosen}
    matched = match_cameras({name: view.look for name, view in missing.items()}, mounts)
    # Of the size of the log's cameras that are used beside it, if there are any.
    beside = next((mounts[name].camera for name in chosen.values()), None)
    for view in missing.values():
        size = view.camera if beside is None else beside
        mount = view.mount((size.width, size.height), np.zeros(3))
        seen = {name: seen_by(mount, [camera]) for name, camera in mounts.items()}
        source = matched.get(view.name) or max(seen, key=lambda name: seen[name].sum(), default="")
        if source:
            mount = view.mount((size.width, size.height), mounts[source].rig_from_camera[:3, 3])
        name = f"virtual_{view.name}"
        while name in mounts or name in made:
            name += "_"
        nothing = np.zeros((size.height, size.width), np.bool_)
        union = np.logical_or.reduce([nothing, *seen.values()])
        made[name] = replace(mount, seen=union, source=source or None)
    return made


def looked_at(planner: Planner, mounts: Mapping[str, CameraMount]) -> dict[str, CameraMount]:
    """The mounts, with the windows that the planner looks at in cameras that show its
    `wanted_views`; where it looks at a camera otherwise, that is left whole.
    """
    windows: dict[str, list[tuple[int, int, int, int]]] = {}
    views = {view.name: view for view in whole(planner, BasePlanner).wanted_views}
    for wanted, name in camera_choice(planner, mounts).items():
        camera = mounts[name].camera
        full = 0, 0, camera.width, camera.height
        view = views.get(wanted)
        windows.setdefault(name, []).append(full if view is None else view.window(mounts[name]))
    found = dict(mounts)
    for name, edges in windows.items():
        left, top, right, bottom = zip(*edges, strict=True)
        window = min(left), min(top), max(right), max(bottom)
        found[name] = replace(mounts[name], window=window)
    return found


@dataclass(frozen=True)
class ShownView:
    """What a planner gets to see under one of its names; plain values, for records.

    Attributes:
        source: the log's camera itself, or that at whose place a virtual one is; None for one with
            a place of its own.
        virtual: whether it is no camera of the log.
        seen: share of it that cameras of the log see; the rest is black.
        width, height: size of the images, pixels.
    """

    view: str
    camera: str
    source: str | None
    virtual: bool
    seen: float
    width: int
    height: int

    def __str__(self) -> str:
        if not self.virtual:
            return self.camera if self.camera == self.view else f"{self.view} by {self.camera}"
        place = f" at {self.source}" if self.source else ""
        return f"{self.view} by a virtual camera{place} ({self.seen:.0%} seen by the log's cameras)"


def shown_views(planner: Planner, mounts: Mapping[str, CameraMount]) -> tuple[ShownView, ...]:
    """What is rendered for a planner; () where it needs no images.

    Args:
        mounts: the log's cameras and `virtual_mounts`.

    Raises:
        InputError: see `camera_choice`; or the log's cameras see less than half of a picture that
            looks ahead.
    """
    views = {view.name: view for view in whole(planner, BasePlanner).wanted_views}
    real = {name: mount for name, mount in mounts.items() if mount.seen is None}
    shown = []
    for wanted, name in camera_choice(planner, mounts).items():
        mount = mounts[name]
        seen = 1.0 if mount.seen is None else float(mount.seen.mean())
        if wanted in views:
            seen = views[wanted].covered(mount)
        if seen < NEEDED and Look.of(mount).angle(_AHEAD) <= WITHIN_DEGREES:
            raise InputError(
                f"planner {planner.name}",
                f"view {wanted}",
                f"looks ahead, but the log's cameras see {seen:.0%} of it ({NEEDED:.0%} is needed)",
                f"use a log with a camera that looks ahead (there are {directions(real)}), or a "
                "planner that uses no images, such as idm-follower",
            )
        virtual = mount.seen is not None
        shown.append(
            ShownView(
                wanted,
                name,
                mount.source if virtual else name,
                virtual,
                seen,
                mount.camera.width,
                mount.camera.height,
            )
        )
    return tuple(shown)


def seen_record(planner: Planner, mounts: Mapping[str, CameraMount]) -> dict[str, Any]:
    """JSON-able: the planner's name, where it computes if it says, what it gets to see, and its
    own `record_fields`."""
    planner = whole(planner, BasePlanner)
    return {
        "planner": planner.name,
        "device": planner.device,
        "views": [asdict(view) for view in shown_views(planner, mounts)],
        **planner.record_fields,
    }


def seen_lines(planner: Planner, mounts: Mapping[str, CameraMount]) -> tuple[str, str | None]:
    """The same for people: what it gets to see, and a warning where that is too little.

    ("", None) for a planner that needs no images and says nothing of itself.
    """
    planner = whole(planner, BasePlanner)
    device, record = planner.device, planner.record_fields
    shown = shown_views(planner, mounts)
    sees = f" sees {'; '.join(map(str, shown))}" if shown else ""
    facts = "".join(f", {key} {fact}" for key, fact in record.items() if isinstance(fact, str))
    said = f"planner {planner.name}{f' on {device}' if device else ''}{facts}{sees}"
    low = [view for view in shown if view.seen < ENOUGH]
    if not low:
        return (said if device or facts or shown else ""), None
    shares = ", ".join(f"{1 - view.seen:.0%} of {view.view}" for view in low)
    return said, f"planner {planner.name} sees black where no camera of the log looks: {shares}"
