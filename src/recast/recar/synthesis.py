"""Synthetic vehicle sets: what one is to hold, and its views, made by several processes."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError, require_range
from recast.core.files import alone_in
from recast.core.workers import worker_pool
from recast.geometry import se3
from recast.recar.vehicle_set import (
    HELD_OUT_SHARE,
    MOST_VIEWS,
    IdentityRecord,
    SetRecord,
    Split,
    VehicleSet,
    begin_set,
    check_begin,
    finish_set,
    read_set,
    regular_azimuths,
    split_of,
    write_identity,
)
from recast.recar.views import (
    ELEVATION_DEG,
    FOV_DEG,
    LARGEST_SIDE,
    camera_pose,
    fitting_distance,
    pinhole,
)

if TYPE_CHECKING:  # readers of sets need no ray tracer
    from recast.synthetic.world import Sky, VehicleModel

SYNTHESIS_VERSION = 1
"""Changes when the same settings give other pictures; a killed run never mixes two."""

_AXES = {".glb": "z,y", ".gltf": "z,y"}  # forward and up by the format's own rule

Group = Literal["vehicle", "shape", "mesh"]
_SHAPE, _LIGHT, _VIEWS = 0, 1, 2  # random streams of one identity


@dataclass(frozen=True)
class SynthesisSettings:
    """What all identities of a synthetic set share.

    Attributes:
        seed: seed of everything random, the split too.
        width, height: width and height of the pictures, in pixels.
        kinds: kinds of vehicles, drawn evenly; as often as on the road where none is named.
        held_out: share of the identities that is never trained on.
    """

    seed: int = 0
    views: int = 30
    width: int = 1200
    height: int = 800
    kinds: tuple[str, ...] = ()
    licence: str = "CC0-1.0"
    held_out: float = HELD_OUT_SHARE

    def validate(self) -> None:
        """Raise InputError naming the option at fault."""
        from recast.synthetic.vehicles import KINDS

        require_range(0, seed=self.seed)
        require_range(1, MOST_VIEWS, views=self.views)
        require_range(16, LARGEST_SIDE, width=self.width, height=self.height)
        require_range(0, 1, held_out=self.held_out)
        for kind in self.kinds:
            if kind not in KINDS:
                raise InputError("`kinds`", kind, "is unknown", f"choose from {', '.join(KINDS)}")
        if not self.licence.strip():
            raise InputError("`licence`", "value", "is empty", "name the licence of the images")

    def record(self, name: str, identities: int) -> SetRecord:
        """The record of the finished set."""
        return SetRecord(
            complete=True,
            name=name,
            licence=self.licence,
            source="renders of parametric vehicles by `recast recar synth`",
            identities=identities,
            azimuths_deg=regular_azimuths(self.views),
            elevation_deg=ELEVATION_DEG,
            fov_deg=FOV_DEG,
            width=self.width,
            height=self.height,
            split_seed=self.seed,
            held_out_share=self.held_out,
            generator={
                "name": "recast.recar.synthesize_set",
                "synthesis_version": SYNTHESIS_VERSION,
                "seed": self.seed,
                "kinds": list(self.kinds),
            },
        )


@dataclass(frozen=True)
class PlannedIdentity:
    """One identity to make.

    Attributes:
        seed: seed of its shape and light; depends on nothing but the set's seed and its own place.
        mesh: mesh file, of the group "mesh".
        mesh_axes: its forward and up axes.
    """

    id: str
    group: Group
    seed: tuple[int, ...]
    split: Split
    mesh: Path | None = None
    mesh_axes: str = ""


def plan_identities(
    settings: SynthesisSettings,
    vehicles: int,
    shapes: int,
    meshes: Sequence[Path],
    mesh_axes: str | None = None,
) -> list[PlannedIdentity]:
    """All identities of a set, in the order in which they are made.

    Raises:
        InputError: a negative count, nothing at all, or a mesh file that is missing or named twice.
    """
    require_range(0, vehicles=vehicles, shapes=shapes)
    if vehicles + shapes + len(meshes) == 0:
        raise InputError(
            "`vehicles`", "value", "is 0, and no shapes or meshes are requested", "give 1 or more"
        )
    plan = [_planned(settings, "vehicle", i, f"vehicle-{i:05d}", i) for i in range(vehicles)]
    plan += [_planned(settings, "shape", i, f"shape-{i:05d}", i) for i in range(shapes)]
    for index, path in enumerate(meshes):
        axes = mesh_axes or _AXES.get(path.suffix.lower(), "x,z")
        digest = _digest(path, axes)
        stem = re.sub(r"[^A-Za-z0-9_-]", "-", path.stem)[:60]
        name = f"mesh-{stem}-{digest}"
        plan.append(_planned(settings, "mesh", index, name, int(digest, 16), path, axes))
    known: set[str] = set()
    for one in plan:
        if one.id in known:
            raise InputError(one.mesh or one.id, "mesh", "is given twice", "give it once")
        known.add(one.id)
    return plan


def _planned(
    settings: SynthesisSettings,
    group: Group,
    index: int,
    name: str,
    own_seed: int,
    mesh: Path | None = None,
    mesh_axes: str = "",
) -> PlannedIdentity:
    stream = ("vehicle", "shape", "mesh").index(group)
    return PlannedIdentity(
        id=name,
        group=group,
        seed=(settings.seed, stream, own_seed),
        split=split_of(name, settings.seed, settings.held_out, index),
        mesh=mesh,
        mesh_axes=mesh_axes,
    )


def _digest(path: Path, axes: str) -> str:
    # Of the content, so that a file that changed is never taken for the finished one.
    if not path.is_file():
        raise InputError(path, "mesh", "is missing", "check the path")
    if len(axes.split(",")) != 2:
        raise InputError("`mesh_axes`", "value", f"is {axes!r}", "give forward and up, such as z,y")
    return hashlib.sha256(axes.encode() + path.read_bytes()).hexdigest()[:8]


def synthesize_set(
    out: str | Path,
    vehicles: int,
    settings: SynthesisSettings | None = None,
    *,
    shapes: int = 0,
    meshes: Sequence[str | Path] = (),
    mesh_axes: str | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> VehicleSet:
    """Render a set of parametric vehicles, other shapes, and the user's own meshes.

    Finished identities stay when the run is killed, and the same call goes on from there; more
    vehicles, shapes or meshes make a finished set grow. Either way the files are the same bytes as
    those of one run, whatever the number of workers.

    Args:
        out: folder of the set; new, empty, or a set of the same settings.
        shapes: number of other shapes: furniture, signs and the like.
        mesh_axes: their forward and up axes, such as "-y,z"; None takes "z,y" for glTF and
            "x,z" for all others.
        progress: called with the pictures of finished identities, and of all.

    Raises:
        InputError: impossible counts or sizes, a mesh that cannot be used, embreex not installed,
            or `out` holds something else, all before any work; or the disk is full.
    """
    from recast.synthetic.rendering import require_embree

    settings, out = settings or SynthesisSettings(), Path(out)
    settings.validate()
    worker_pool(workers)  # refuses less than one
    plan = plan_identities(settings, vehicles, shapes, [Path(mesh) for mesh in meshes], mesh_axes)
    ids = [planned.id for planned in plan]
    record = settings.record(out.absolute().name, len(plan))
    check_begin(out, record, ids)
    require_embree()
    for planned in plan:
        if planned.mesh is not None:
            make_model(planned, settings)  # refuses what cannot be used
    finished = begin_set(out, record, ids)
    left = [planned for planned in plan if planned.id not in finished]
    waiting, done = iter(left), len(finished)
    with alone_in(out):
        tell(progress, done * record.views, len(plan) * record.views)
        pool = worker_pool(min(workers, max(len(left), 1)))
        arguments = out, record, settings
        for _ in pool(_start, arguments, lambda: next(waiting, None), "finished identities"):
            done += 1
            tell(progress, done * record.views, len(plan) * record.views)
        finish_set(out, record)
    return read_set(out)


def _start(
    _: int, out: Path, record: SetRecord, settings: SynthesisSettings
) -> Callable[[PlannedIdentity], None]:
    def make(planned: PlannedIdentity) -> None:
        model = make_model(planned, settings)
        identity = identity_record(planned, model, record)
        write_identity(out, record, identity, render_views(model, identity, record))

    return make


def make_model(planned: PlannedIdentity, settings: SynthesisSettings) -> VehicleModel:
    """The shape of a planned identity.

    Raises:
        InputError: its mesh file cannot be used.
    """
    from recast.synthetic.vehicles import read_mesh, sample_shape, sample_vehicle

    if planned.mesh is not None:
        forward, up = planned.mesh_axes.split(",")
        return read_mesh(planned.mesh, forward=forward, up=up)
    rng = np.random.default_rng([*planned.seed, _SHAPE])
    if planned.group == "shape":
        return sample_shape(rng)
    kinds = settings.kinds
    return sample_vehicle(rng, kinds[int(rng.integers(len(kinds)))] if kinds else None)


def studio_sky(rng: np.random.Generator) -> Sky:
    """Soft daylight: a high, large, weak sun somewhere around the vehicle, and a bright sky."""
    from recast.synthetic.world import Sky

    azimuth = rng.uniform(0, 2 * np.pi)
    elevation = np.radians(rng.uniform(40, 65))
    strength = rng.uniform(1.0, 2.0)
    warmth = rng.uniform(-0.04, 0.04)
    return Sky(
        sun_direction=se3.direction(azimuth, elevation),
        sun=strength * np.array([1.0 + warmth, 1.0, 1.0 - warmth]),
        zenith=np.array([0.62, 0.66, 0.72]),
        horizon=np.array([0.70, 0.71, 0.73]),
        sun_radius=0.15,
        clouds=0.0,
        seed=int(rng.integers(2**31)),
    )


def identity_record(
    planned: PlannedIdentity, model: VehicleModel, record: SetRecord
) -> IdentityRecord:
    """What identity.json says about a model, the distance of its cameras included."""
    assert record.fov_deg is not None and record.elevation_deg is not None
    # Mirrors reach beyond the box; the cameras look at the centre of the box nonetheless.
    reach = 2 * np.abs(model.surface.bounds()).max(axis=0)
    camera = pinhole(record.width, record.height, record.fov_deg)
    distance = fitting_distance(np.maximum(reach, model.size), camera, record.elevation_deg)
    length, width, height = (round(float(metres), 4) for metres in model.size)
    return IdentityRecord(
        id=planned.id,
        kind=model.kind,
        category=model.category,
        colour=model.colour if planned.mesh is None else None,
        size=(length, width, height),
        distance_m=round(distance, 4),
        split=planned.split,
        source=None if planned.mesh is None else planned.mesh.name,
        seed=planned.seed,
    )


def render_views(
    model: VehicleModel, identity: IdentityRecord, record: SetRecord
) -> Iterator[Image]:
    """The pictures of a model, (height, width, 4) uint8 RGBA with straight alpha, in order.

    Raises:
        InputError: embreex is not installed.
    """
    from recast.synthetic.rendering import RayScene, render_camera
    from recast.synthetic.surface import concatenate

    assert identity.seed is not None and identity.distance_m is not None
    assert record.fov_deg is not None and record.elevation_deg is not None
    scene = RayScene(concatenate([]), {"vehicle": model.surface})
    sky = studio_sky(np.random.default_rng([*identity.seed, _LIGHT]))
    camera = pinhole(record.width, record.height, record.fov_deg)
    for index, azimuth in enumerate(record.azimuths_deg):
        pose = camera_pose(azimuth, record.elevation_deg, identity.distance_m)
        left, top, right, bottom = _rectangle(model, camera, pose)
        # Two pixels in three show nothing; not casting their rays saves a third of the time.
        frame = render_camera(
            scene,
            sky,
            camera.cropped(left, top, right - left, bottom - top),
            pose,
            {"vehicle": np.eye(4)},
            rng=np.random.default_rng([*identity.seed, _VIEWS, index]),
        )
        picture = np.zeros((record.height, record.width, 4), np.uint8)
        picture[top:bottom, left:right, :3] = frame.rgb
        picture[top:bottom, left:right, 3] = np.round(255 * frame.alpha)
        yield picture


def _rectangle(
    model: VehicleModel, camera: PinholeCamera, actor_from_camera: Array
) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the pixels that can show the model."""
    points = se3.apply(se3.inverse(actor_from_camera), model.surface.vertices)
    pixels, _ = camera.project(points)
    left, top = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
    right, bottom = np.ceil(pixels.max(axis=0)).astype(int)
    return int(left), int(top), min(int(right), camera.width), min(int(bottom), camera.height)
