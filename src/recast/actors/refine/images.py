"""What the images show of a vehicle, and what surrounds it in them.

Only the vehicle changes while it is refined. A step draws the vehicle alone and puts it between
two layers, drawn once from the scene, which costs a fifth of drawing the whole street.

The scene knows the road without the vehicle, the images show it with the vehicle's shadow. Places
that got darker tell the direction of the sun better than all walls of a street.

How much of the vehicle was seen, mirrored or invented is told by weights: that of a Gaussian in a
picture is the sum over pixels of its transmittance times its alpha. The rasterizer gives it as the
derivative of the picture's sum by a constant colour, so that occlusion, opacity and the vehicle's
own parts in between are all in it.

A generator misses the paint's colour a little, and misses it everywhere alike. Where images have
corrected it, the correction is known; parts that no image shows take over that of parts which the
generator gave the same look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from recast.actors.actor import Actor, Shares
from recast.actors.evidence import Evidence, Sighting
from recast.actors.icp import outer_surface, thinned
from recast.actors.refine.settings import REFINE
from recast.arrays import Array
from recast.geometry import boxes, se3
from recast.geometry.colour import GAMMA
from recast.scene import StreetScene
from recast.scene.actor import draw, mirrored
from recast.scene.light import CastShadow, SceneLight, darkened
from recast.scene.light.sun import DIRECTIONS
from recast.scene.sky import composite, pixel_coordinates
from recast.splats import Gaussians, LowPass, concatenate, refiltered
from recast.splats.gaussians import C0, quat_to_matrix


@dataclass(frozen=True)
class Layers:
    """One sighting, ready to be compared with the vehicle between its layers."""

    sighting: Sighting  # the image, its mask and cameras
    target: Tensor  # (H, W, 3) float32, the image with the gain of its exposure undone
    street: Tensor  # (H, W, 3) float32, everything behind the vehicle but its shadow, sky included
    shade: Tensor  # (H, W) float32, opacity of the vehicle's shadow on it
    front: Tensor  # (H, W, 3) float32, what is nearer, weighted by its own opacity
    through: Tensor  # (H, W) float32, share of light that passes what is nearer
    # mask, trust: (H, W) float32, see `Sighting`.
    mask: Tensor
    trust: Tensor
    # (H, W) float32 in [0, 1]: `trust`, but less at the mask's border, which is off by a pixel.
    outlined: Tensor
    # (H, W) float32 in [0, 1], where colours are compared: on the vehicle and its edge.
    compared: Tensor
    # (H, W) float32 in [0, 1], road beside the vehicle, where its shadow is compared.
    road: Tensor
    # camera_from_world, world_from_object: (4, 4) float32.
    camera_from_world: Tensor
    world_from_object: Tensor

    def around(self, rgb: Tensor, alpha: Tensor, back: Tensor | None = None) -> Tensor:
        """The picture (H, W, 3) of a vehicle drawn alone as rgb (H, W, 3) and alpha (H, W).

        Args:
            back: (H, W, 3) street with the vehicle's shadow; by `shade` if None.
        """
        if back is None:
            back = self.street * (1 - self.shade)[..., None]
        inner = rgb + (1 - alpha)[..., None] * back
        return self.front + self.through[..., None] * inner


def make_layers(scene: StreetScene, evidence: Evidence, shadow: Gaussians) -> list[Layers]:
    """The layers of every sighting, from a scene that may hold a model of the track or not.

    Args:
        shadow: shadow of the vehicle, actor frame; it lies behind the vehicle.
    """
    return [_layers(scene, evidence, sighting, shadow) for sighting in evidence.sightings]


def _layers(
    scene: StreetScene, evidence: Evidence, sighting: Sighting, shadow: Gaussians
) -> Layers:
    camera = sighting.camera
    view = torch.from_numpy(sighting.camera_from_world).float()
    K = torch.from_numpy(camera.matrix).float()
    poses = scene.actor_poses(sighting.timestamp_us)
    low_pass = scene.low_pass
    parts = [scene.background]
    for track_id, pose in poses.items():
        if track_id != evidence.track_id:
            time = sighting.timestamp_us
            actor = scene.actors[track_id].coloured_at(time).shaped_at(time)
            posed = actor.gaussians.transformed(torch.from_numpy(pose))
            parts.append(refiltered(posed, actor.low_pass, low_pass, view, K))
    cast = shadow.transformed(torch.from_numpy(sighting.world_from_object))
    street = concatenate(parts).detach()
    nearer = _nearer(street, evidence, sighting)
    with torch.no_grad():
        front, back = (
            draw(street.select(chosen), view, camera, low_pass) for chosen in (nearer, ~nearer)
        )
        shade = draw(cast, view, camera).alpha
        behind = composite(
            back.rgb,
            back.alpha,
            scene.sky.colours,
            pixel_coordinates(camera, sighting.camera_from_world),
        ).clamp(0, 1)
    image = torch.from_numpy(sighting.image).float() / 255
    mask, trust = torch.from_numpy(sighting.mask), torch.from_numpy(sighting.trust)
    through = 1 - front.alpha
    shaded = behind * (1 - shade)[..., None]
    gain = _gain(image, front.rgb + through[..., None] * shaded, mask, trust)
    solid = (sighting.mask > 0.05).astype(np.uint8)
    element = np.ones((2 * REFINE.edge_px + 1,) * 2, np.uint8)
    reach = cv2.dilate(solid, np.ones((2 * REFINE.beside_px + 1,) * 2, np.uint8))
    border = (cv2.dilate(solid, element) > 0) & (cv2.erode(solid, element) == 0)
    doubt = np.where(border, np.float32(REFINE.border_weight), np.float32(1))
    usable = (trust > 0) * (through > 0.5)
    beside, _ = _ground(sighting, evidence.size, -evidence.size[2] / 2, REFINE.shadow_reach_m)
    return Layers(
        sighting=sighting,
        target=(image / gain).clamp(0, 1),
        street=behind,
        shade=shade,
        front=front.rgb,
        through=through,
        mask=mask,
        trust=trust,
        outlined=trust * torch.from_numpy(doubt),
        compared=torch.from_numpy(reach).float() * usable,
        road=torch.from_numpy(beside & (reach == 0)).float() * usable,
        camera_from_world=view,
        world_from_object=torch.from_numpy(sighting.world_from_object).float(),
    )


def _nearer(street: Gaussians, evidence: Evidence, sighting: Sighting) -> Tensor:
    """(N,) bool: Gaussians before the nearest corner of the box; the road under it is not."""
    corners = boxes.corners(evidence.size, sighting.camera_from_object)
    pose = torch.from_numpy(sighting.camera_from_world).float()
    depth = street.means @ pose[2, :3] + pose[2, 3]
    return depth < float(corners[:, 2].min())


def _gain(image: Tensor, street: Tensor, mask: Tensor, trust: Tensor) -> Tensor:
    """(3,) factors of the image's colours over the scene's beside the vehicle, near one."""
    element = np.ones((7, 7), np.uint8)
    near = torch.from_numpy(cv2.dilate((mask.numpy() > 0.05).astype(np.uint8), element) > 0)
    beside = ~near & (trust > 0)
    shown, wanted = street[beside], image[beside]
    prior = REFINE.gain_prior_px * 0.25
    gain = ((shown * wanted).sum(0) + prior) / ((shown * shown).sum(0) + prior)
    return gain.clamp(*REFINE.gains)


@dataclass(frozen=True)
class RoadPixels:
    """Pixels of one image that show road beside a vehicle."""

    places: Array  # (P, 2) metres, where they lie on the ground of the actor frame
    image: Array  # (P,) display values, mean of the channels, the gain of the exposure undone
    street: Array  # (P,) the same of the scene without the vehicle
    pose: Array  # (4, 4) `world_from_actor`
    weight: float  # what the image counts beside the others, see `recast.actors.evidence.Sighting`


@dataclass(frozen=True)
class ShadowEvidence:
    """What the images of a vehicle say of its shadow."""

    # (D,) logarithms of how likely the sun stands in each of `recast.scene.light.sun`'s directions,
    # world frame, up to a constant; zeros where nothing is told.
    sun: Array
    darkness: float  # factor of the contact shadow's opacity; one where nothing is told


def shadow_evidence(actor: Actor, scene: StreetScene, views: Sequence[Layers]) -> ShadowEvidence:
    """Compare the road about a registered actor with its shadow.

    Every image counts as one measurement: -n/2 log(1 - r^2) for the correlation r between the
    logarithms of the expected and the found loss of light, r > 0.
    """
    if len(actor.shadow) == 0:
        return ShadowEvidence(np.zeros(DIRECTIONS), 1.0)
    floor = float(actor.shadow.means[:, 2].median())
    roads = [one for view in views if (one := road_pixels(view, actor.size, floor)) is not None]
    light = SceneLight.of(scene)
    shadow = CastShadow(outer_surface(actor.gaussians).points, actor.shadow, actor.size)
    expected = [
        shadow.left(light.place(road.pose, actor.size), float(se3.yaw(road.pose)), road.places)
        for road in roads
    ]
    sun = _sun(roads, [left for left, _ in expected])
    probability = light.sun.given(sun).probability
    found, square = REFINE.darkness_prior, REFINE.darkness_prior
    for road, (left, without_contact) in zip(roads, expected, strict=True):
        # Linear light: image over street = without contact - darkness x (without contact - left).
        ratio = np.clip(road.image / np.maximum(road.street, REFINE.black), 0, 1) ** GAMMA
        missing = probability @ without_contact - ratio
        hidden = probability @ (without_contact - left)
        found += road.weight * float(missing @ hidden)
        square += road.weight * float(hidden @ hidden)
    return ShadowEvidence(sun, min(max(found / square, REFINE.darkness[0]), REFINE.darkness[1]))


def shadow_sheet(
    actor: Actor, scene: StreetScene, told: ShadowEvidence, poses: Sequence[Array]
) -> Gaussians:
    """The shadow that the sun and the sky cast on the ground around an actor, at the middle pose.

    Places without shadow are in it, too, but nothing beyond `shadow_reach_m`; nothing at all for
    an actor without a contact shadow.
    """
    if len(actor.shadow) == 0:
        return actor.shadow
    light = SceneLight.of(scene)
    light = replace(light, sun=light.sun.given(told.sun))
    contact = darkened(actor.shadow, told.darkness)
    cast = CastShadow(outer_surface(actor.gaussians).points, contact, actor.size)
    pose = poses[len(poses) // 2]
    sheet = cast.sheet(light, light.place(pose, actor.size), float(se3.yaw(pose)), whole=True)
    half = torch.from_numpy(actor.size[:2] / 2 + REFINE.shadow_reach_m)
    return sheet.select((sheet.means[:, :2].abs() < half).all(dim=1))


def road_pixels(view: Layers, size: Array, floor: float) -> RoadPixels | None:
    """The road pixels of one image; None if there are only a few.

    Args:
        size: (3,) size of the vehicle's box, metres.
        floor: height of the ground in the actor frame.
    """
    sighting = view.sighting
    around = (
        cv2.dilate((sighting.mask > REFINE.on_it).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    )
    beside = ~around & (sighting.trust > 0) & (view.through.numpy() > REFINE.clear)
    ground, places = _ground(sighting, size, floor, REFINE.road_reach_m)
    rows, columns = np.nonzero(beside & ground)
    if len(rows) < REFINE.fewest_road_pixels:
        return None
    rows, columns = thinned(np.stack([rows, columns], -1), REFINE.road_pixels).T
    image, street = (
        layer.numpy()[rows, columns].astype(np.float64).mean(axis=1)
        for layer in (view.target, view.street)
    )
    return RoadPixels(
        places[rows, columns], image, street, sighting.world_from_object, sighting.weight
    )


def _ground(
    sighting: Sighting, size: Array, floor: float, reach: float
) -> tuple[NDArray[np.bool_], Array]:
    """Pixels (H, W) that look at the ground around a box, and where (H, W, 2) metres, actor frame.

    Args:
        reach: metres around the box.
    """
    object_from_camera = se3.inverse(sighting.camera_from_object)
    camera = sighting.camera
    rays = camera.rays(camera.pixel_grid().reshape(-1, 2)) @ object_from_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        distance = (floor - object_from_camera[2, 3]) / rays[:, 2]
    down = (rays[:, 2] < 0) & (distance > 0)
    places = object_from_camera[:2, 3] + np.where(down, distance, 0)[:, None] * rays[:, :2]
    near = down & (np.abs(places) < size[:2] / 2 + reach).all(axis=1)
    shape = (camera.height, camera.width)
    return near.reshape(shape), places.reshape(*shape, 2)


def _sun(roads: Sequence[RoadPixels], expected: Sequence[Array]) -> Array:
    """(D,) see `ShadowEvidence`; `expected` is the share of light left, (D, P) for each image."""
    cross, square, total = np.zeros(DIRECTIONS), np.full(DIRECTIONS, 1e-12), 1e-12
    for road, left in zip(roads, expected, strict=True):
        wanted = np.log((road.image + REFINE.black) / (road.street + REFINE.black))
        wanted = np.clip(wanted, -REFINE.strongest, REFINE.strongest)
        shade = np.log(np.maximum(left, REFINE.black)) / GAMMA
        wanted, shade = wanted - wanted.mean(), shade - shade.mean(axis=1, keepdims=True)
        share = road.weight / len(wanted)
        cross = cross + share * (shade @ wanted)
        square = square + share * (shade * shade).sum(axis=1)
        total += share * float(wanted @ wanted)
    r = np.maximum(cross / np.sqrt(square * total), 0.0)
    return -0.5 * len(roads) * np.log(np.maximum(1 - r * r, 1e-6))


@dataclass(frozen=True)
class Visibility:
    """What images show of N Gaussians, in pixels of the patch of surface around each."""

    own: Tensor  # (N,) float32 sum over all images, weighted as they are
    twin: Tensor  # (N,) the same sum of the mirrored vehicle
    shown: Tensor  # (N,) bool, which Gaussians themselves are in a picture, or mirrored in one
    drawn: Tensor  # (N,) bool, which have any part in a picture, if only through others

    @property
    def shares(self) -> Shares:
        """Where each comes from."""
        seen = 1 - torch.exp(-self.own / REFINE.seen_px)
        return Shares(seen, (1 - seen) * (1 - torch.exp(-self.twin / REFINE.seen_px)))

    def freedom(self, gaussians: Gaussians) -> Tensor:
        """(N,) in [0, 1] how far each of `gaussians` may leave the prior, smoothly over them."""
        shares = self.shares
        own = shares.seen + REFINE.mirrored_freedom * shares.mirrored
        points = gaussians.means.detach().numpy()
        _, near = cKDTree(points).query(points, k=min(REFINE.neighbours, len(points)))
        around = own[torch.from_numpy(near.reshape(len(points), -1))].mean(dim=1)
        return 0.5 * (own + around)

    def select(self, index: Tensor) -> Visibility:
        """That of the Gaussians at `index`."""
        return Visibility(self.own[index], self.twin[index], self.shown[index], self.drawn[index])


def pixel_weights(
    gaussians: Gaussians, low_pass: LowPass, layers: Layers, pixels: Tensor
) -> Tensor:
    """(N,) sum over pixels of transmittance times alpha of each Gaussian, weighted by `pixels`.

    Args:
        gaussians: Gaussians in the actor frame.
        pixels: (H, W) weights.
    """
    # One constant colour of its own a Gaussian, far from the clamp at zero.
    white = gaussians.sh.new_zeros(len(gaussians), 1, 3).requires_grad_()
    pose = layers.camera_from_world @ layers.world_from_object
    drawn = draw(replace(gaussians.detach(), sh=white), pose, layers.sighting.camera, low_pass)
    (drawn.rgb[..., 0] * pixels).sum().backward()
    assert white.grad is not None
    return white.grad[:, 0, 0].abs() / C0


def visibility_of(
    gaussians: Gaussians, low_pass: LowPass, views: Sequence[Layers], symmetric: bool
) -> Visibility:
    """What all images show of Gaussians in the actor frame.

    Args:
        symmetric: whether the other side may teach.
    """
    everything = torch.ones(len(gaussians), dtype=torch.bool)
    other = mirrored(gaussians.detach(), everything)
    own, twin = torch.zeros(len(gaussians)), torch.zeros(len(gaussians))
    for view in views:
        pixels = view.sighting.weight * view.mask * view.trust * view.through
        own += pixel_weights(gaussians, low_pass, view, pixels)
        if symmetric:
            twin += pixel_weights(other, low_pass, view, pixels)
    reach = max(
        REFINE.patch_m,
        REFINE.patch_px * min((_metres_a_pixel(view) for view in views), default=0.0),
    )
    patches = _Patches(gaussians.means.detach().numpy(), reach)
    shown, drawn = (own + twin > least for least in (REFINE.shown_px, REFINE.drawn_px))
    return Visibility(patches.sum(own), patches.sum(twin), shown, drawn)


class _Patches:
    """Sums over all points within `reach` of each of points (N, 3), up to half a `reach`.

    Points are gathered in cells half as wide: the number of pairs does not grow with `reach`.
    """

    def __init__(self, points: NDArray[np.float32], reach: float) -> None:
        places = np.floor(points / (reach / 2)).astype(np.int64)
        _, found, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
        cell = found.reshape(-1)
        centres = np.stack([np.bincount(cell, one) for one in points.T], axis=-1) / count[:, None]
        tree = cKDTree(centres)
        pairs = tree.sparse_distance_matrix(tree, reach, output_type="coo_matrix")
        self._cell, self._cells = torch.from_numpy(cell), len(centres)
        self._rows = torch.from_numpy(pairs.row.astype(np.int64))
        self._columns = torch.from_numpy(pairs.col.astype(np.int64))

    def sum(self, pixels: Tensor) -> Tensor:
        """Sums (N,) of `pixels` (N,) around each point."""
        own = pixels.new_zeros(self._cells).index_add(0, self._cell, pixels)
        around = torch.zeros_like(own).index_add(0, self._rows, own[self._columns])
        return around[self._cell]


def _metres_a_pixel(view: Layers) -> float:
    """Size of a pixel at the vehicle's middle, metres."""
    depth = (view.camera_from_world @ view.world_from_object)[2, 3]
    return float(depth / view.sighting.camera.fx)


def follow_paint(prior: Gaussians, refined: Gaussians, shares: Shares) -> Gaussians:
    """The refined Gaussians, the invented ones with the correction of those that look alike.

    Args:
        prior: Gaussians as the generator made them, row by row those of `refined`.
        refined: refined Gaussians, actor frame.
        shares: shares that tell where each Gaussian comes from; the invented share of the
            correction is taken over.
    """
    known = (shares.seen + shares.mirrored).numpy()
    lenders = np.flatnonzero(known > REFINE.known)
    if len(lenders) == 0:
        return refined
    features = _features(prior)
    change = (refined.sh[:, 0] - prior.sh[:, 0]).numpy().astype(np.float64)
    borrowers = np.flatnonzero(known < 1 - 1e-3)
    count = min(REFINE.lenders, len(lenders))
    distance, near = cKDTree(features[lenders]).query(features[borrowers], k=count)
    distance, near = distance.reshape(len(borrowers), -1), near.reshape(len(borrowers), -1)
    weight = np.exp(-0.5 * distance**2) * known[lenders][near]
    lent = np.einsum("nk,nkc->nc", weight, change[lenders][near])
    lent /= (weight.sum(axis=1) + REFINE.doubt)[:, None]
    sh = refined.sh.clone()
    share = shares.invented.numpy()[borrowers, None]
    sh[borrowers, 0] += torch.from_numpy(share * (lent - change[borrowers])).float()
    return replace(refined, sh=sh)


def _features(gaussians: Gaussians) -> Array:
    """(N, 8) look, normal, height and place, each over what counts as one."""
    axes = quat_to_matrix(gaussians.quats)
    thin = gaussians.log_scales.argmin(dim=1)
    up = axes[:, 2].gather(1, thin[:, None]).abs()
    look: Tensor = (0.5 + C0 * gaussians.sh[:, 0]).clamp(0, 1)
    parts = (
        look / REFINE.look,
        up / REFINE.upright,
        gaussians.means[:, 2:] / REFINE.height_m,
        gaussians.means[:, :2] * torch.tensor([1.0, 0.0]) / REFINE.place_m,
    )
    return torch.cat(parts, dim=1).detach().numpy().astype(np.float64)
