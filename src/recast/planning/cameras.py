"""Which cameras a planner looks at: only those are rendered for it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from recast.errors import InputError
from recast.planning.types import CameraMount, Planner


def named_cameras(planner: Planner) -> tuple[str, ...] | None:
    """The planner's attribute `camera_names`; None where it has none."""
    names = getattr(planner, "camera_names", None)
    return None if names is None else tuple(names)


def planner_cameras(
    planner: Planner, mounts: Mapping[str, CameraMount], otherwise: Iterable[str] | None = None
) -> tuple[str, ...]:
    """Names of the cameras to render for a planner: the values of `camera_choice`."""
    return tuple(camera_choice(planner, mounts, otherwise).values())


def camera_choice(
    planner: Planner, mounts: Mapping[str, CameraMount], otherwise: Iterable[str] | None = None
) -> dict[str, str]:
    """What the planner calls its cameras, and which ones are rendered for that.

    In this order: none where it needs no images; what its method `choose_cameras(mounts)` returns,
    names or a mapping to names; its attribute `camera_names`; `otherwise`. The planner may lack the
    method and the attribute.

    Args:
        mounts: the cameras that can be rendered.
        otherwise: for planners that do not say; None for all.

    Raises:
        InputError: a camera is not there; or what `choose_cameras` raises.
    """
    if not planner.needs_images:
        return {}
    choose = getattr(planner, "choose_cameras", None)
    names = named_cameras(planner) if choose is None else choose(mounts)
    if names is None:
        names = tuple(mounts if otherwise is None else otherwise)
    choice = dict(names) if isinstance(names, Mapping) else {name: name for name in names}
    require_cameras(choice.values(), mounts, f"planner {planner.name}")
    return choice


def require_cameras(names: Iterable[str], there: Mapping[str, object], where: str) -> None:
    """Check that all cameras are there.

    Args:
        where: who wants them, for the message.

    Raises:
        InputError: names the first that is not.
    """
    for name in names:
        if name not in there:
            raise InputError(
                where, f"camera {name}", "is needed and not there",
                f"there are {', '.join(there) or 'none'}; render it, or name other cameras",
            )  # fmt: skip
