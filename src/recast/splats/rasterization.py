"""What a pass of rasterization is given and gives, its low-pass filter, and a readable rasterizer.

3DGS widens every projected Gaussian by 0.3 px^2 and leaves its opacity, so that small ones gain
weight. Mip-Splatting (Yu et al. 2024) lowers the opacity by as much as the Gaussian grew; TRELLIS
trains its decoder through that filter with 0.1 px^2. An asset looks right only through the filter
that it was made for, and a scene is drawn in one pass.

Every formula of the native kernel is here in its simplest form; the tests compare the two,
gradients included. It works in the dtype of the Gaussians, and is hundreds of times slower than the
kernel. Sources: Zwicker et al. 2001 (EWA splatting), Kerbl et al. 2023 (3DGS), Yu et al. 2024
(Mip-Splatting, the opacity compensation).
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from recast.core.errors import InputError
from recast.splats.gaussians import LOG_SCALES, Gaussians, evaluate_harmonics, quat_to_matrix

_LEAST_SHARE = 1e-4
"""Smallest share of itself to which a variance is lowered."""
_LEAST_OPAQUE, _MOST_OPAQUE = 1e-12, 1 - 1e-4
_LARGEST_EXPONENT = 80.0  # of e in float32
_LARGEST_FACTOR = 1e38  # of an opacity in float32: infinity times zero is not a number
_INSIDE = 1e-3  # the ends of a range do not belong to it


@dataclass(frozen=True)
class LowPass:
    """A low-pass filter on the image plane.

    Attributes:
        variance: variance added to every projected covariance, px^2; `eps2d` of `rasterize`.
        antialiased: whether opacity is lowered so that the filter keeps a Gaussian's integral.

    Raises:
        ValueError: a variance that is negative or not finite.
    """

    variance: float = 0.3
    antialiased: bool = False

    def __post_init__(self) -> None:
        if not (isfinite(self.variance) and self.variance >= 0):
            raise ValueError(f"LowPass.variance: {self.variance}, expected 0 or more")

    def text(self) -> str:
        """How files declare it, such as "0.1 antialiased"; see `parse_low_pass`."""
        return f"{self.variance:g}{' antialiased' if self.antialiased else ''}"


def parse_low_pass(where: str | Path, text: str) -> LowPass:
    """The filter that a file declares.

    Args:
        where: the file, for messages.

    Raises:
        InputError: it cannot be understood.
    """
    match text.split():
        case [variance, *kind] if kind in ([], ["antialiased"]):
            with suppress(ValueError):
                return LowPass(float(variance), antialiased=bool(kind))
    raise InputError(
        where,
        "low-pass filter",
        f"{text!r} cannot be understood",
        "write a variance in px^2, such as '0.1 antialiased'",
    )


CLASSIC = LowPass()
"""3D Gaussian splatting (Kerbl et al. 2023) and its viewers; the default of `rasterize`, through
which scenes are trained and drawn."""
MIP = LowPass(0.1, antialiased=True)
"""Mip-Splatting; TRELLIS and what is trained like it."""


def refiltered(
    gaussians: Gaussians, made_for: LowPass, drawn_by: LowPass, camera_from_world: Tensor, K: Tensor
) -> Gaussians:
    """Gaussians that look through one filter as these do through the filter they were made for.

    For one view. Their variances are lowered by what the pass adds too much, in px^2 at their depth
    and as far as they go; their opacities are set so that each keeps its integral over the image.
    Gaussians larger than the filters come out the same; of those much smaller than a pixel the
    weight is the same, spread a little wider.

    Args:
        gaussians: N Gaussians in the world frame.
        made_for: filter that they were made for.
        drawn_by: filter of the pass.
        camera_from_world: (4, 4) rigid, OpenCV axes.
        K: (3, 3) pinhole intrinsics, pixels.
    """
    if made_for == drawn_by or len(gaussians) == 0:
        return gaussians
    camera_from_world, K = camera_from_world.to(gaussians.means), K.to(gaussians.means)
    rotation, translation = camera_from_world[:3, :3], camera_from_world[:3, 3]
    x, y, z = (gaussians.means @ rotation.T + translation).unbind(-1)
    z = z.clamp(min=1e-3)  # what is behind the camera is not drawn
    fx, fy, zero = K[0, 0] / z, K[1, 1] / z, torch.zeros_like(z)
    rows = [torch.stack([fx, zero, -fx * x / z], -1), torch.stack([zero, fy, -fy * y / z], -1)]
    pixels_from_axes = torch.stack(rows, dim=1) @ rotation @ quat_to_matrix(gaussians.quats)

    surplus = (drawn_by.variance - made_for.variance) / (fx * fy)  # px^2 as a variance in space
    share = 1 - surplus[:, None] * (-2 * gaussians.log_scales).clamp(max=_LARGEST_EXPONENT).exp()
    log_scales = gaussians.log_scales + 0.5 * share.clamp(min=_LEAST_SHARE).log()
    log_scales = log_scales.clamp(LOG_SCALES[0] + _INSIDE, LOG_SCALES[1] - _INSIDE)
    before = _weight(pixels_from_axes, gaussians.log_scales, made_for)
    after = _weight(pixels_from_axes, log_scales, drawn_by)
    factor = (before / after.clamp(min=1e-60)).clamp(max=_LARGEST_FACTOR).to(z)
    opacities = gaussians.logit_opacities.sigmoid() * factor
    logits = opacities.clamp(_LEAST_OPAQUE, _MOST_OPAQUE).logit()
    return replace(gaussians, log_scales=log_scales, logit_opacities=logits)


def _weight(pixels_from_axes: Tensor, log_scales: Tensor, low_pass: LowPass) -> Tensor:
    """Integral over the image of Gaussians of opacity one, over 2 pi, px^2, float64.

    Args:
        pixels_from_axes: (N, 2, 3) matrices from metres along a Gaussian's axes to pixels.
        log_scales: (N, 3).
    """
    axes = pixels_from_axes.double() * log_scales.double().exp()[:, None]
    first, second = axes.unbind(1)
    determinant = torch.linalg.cross(first, second).square().sum(-1)
    if not low_pass.antialiased:  # of covariance + variance I
        trace = axes.square().sum(dim=(1, 2))
        determinant = determinant + low_pass.variance * (trace + low_pass.variance)
    return determinant.sqrt()


ALPHA_THRESHOLD = 1.0 / 255.0
"""A Gaussian that covers a pixel by less than this does not touch it."""
TRANSMITTANCE_THRESHOLD = 1e-4
"""A pixel is finished before the Gaussian that would bring its transmittance to this or below."""
LARGEST_DETERMINANT = 1e30
"""A Gaussian whose covariance in the image has this determinant or more, px^4, is not drawn."""
LARGEST_PIXELS = 1e30
"""Bound of focal lengths and centres in pixels, which must be numbers of float32."""
TILE = 16
"""Edge of a tile, pixels."""
TANGENT_MARGIN = 0.3
"""The Jacobian is taken no farther outside the image than this part of the half field of view."""


Window = tuple[int, int, int, int]
"""Left, top, right and bottom edge of a part of an image, pixels."""


@dataclass
class RasterMeta:
    """Per-Gaussian facts of one rasterization, for densification and sparse optimisers.

    Attributes:
        visible: (N,) bool, touched the image.
        radii: (N,) float32, half the longer edge of the bounding box, pixels, rounded up; 0 where
            not visible.
        means2d: (N, 2) projected centres, pixels of the whole image; 0 where not visible.
        means2d_grad: (N, 2) d loss / d means2d, per pixel; None before the backward pass.
        means2d_absgrad: (N, 2) likewise, but the sizes of what the pixels contribute added up, each
            component by itself (AbsGS); None where it was not asked for.
    """

    visible: Tensor
    radii: Tensor
    means2d: Tensor
    means2d_grad: Tensor | None = None
    means2d_absgrad: Tensor | None = None


@dataclass(frozen=True)
class RasterImages:
    """One rendered view.

    Attributes:
        rgb: (H, W, 3) colour, composited over the background where one is given; not clamped.
        depth: (H, W) sum of T alpha z, metres, not divided by alpha.
        alpha: (H, W) accumulated opacity.
    """

    rgb: Tensor
    depth: Tensor
    alpha: Tensor


@dataclass(frozen=True)
class Rasterization(RasterImages):
    """One rendered view, with per-Gaussian facts in `meta`."""

    meta: RasterMeta


@dataclass(frozen=True)
class RasterSettings:
    """The numbers of one view besides poses and Gaussians; raises ValueError for one at fault.

    Attributes:
        width, height: size of the whole image.
        window: the part of it that is drawn; None for all of it.
        others: as of `rasterize`.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    near: float
    far: float
    eps2d: float
    antialiased: bool
    max_alpha: float
    absgrad: bool = False
    window: Window | None = None

    @property
    def drawn(self) -> Window:
        """The part of the whole image that is drawn."""
        return (0, 0, self.width, self.height) if self.window is None else self.window

    def __post_init__(self) -> None:
        if not (0 < self.width <= 65536 and 0 < self.height <= 65536):
            raise ValueError(f"rasterize: image of {self.width}x{self.height} pixels")
        left, top, right, bottom = self.drawn
        if not (0 <= left < right <= self.width and 0 <= top < bottom <= self.height):
            size = f"{self.width}x{self.height}"
            raise ValueError(f"rasterize: window {self.drawn} is not a part of {size} pixels")
        if not 0 < self.near < self.far:
            near_and_far = f"near {self.near} and far {self.far}"
            raise ValueError(f"rasterize: {near_and_far}, expected 0 < near < far")
        if not (self.eps2d >= 0 and math.isfinite(self.eps2d)):
            raise ValueError(f"rasterize: eps2d {self.eps2d}, expected a number >= 0")
        if not ALPHA_THRESHOLD < self.max_alpha < 1:
            raise ValueError(f"rasterize: max_alpha {self.max_alpha}, expected between 1/255 and 1")


def check_settings(
    camera_from_world: Tensor, K: Tensor, background: Tensor | None, **numbers: Any
) -> RasterSettings:
    """Check the view; `numbers` are the other members of its settings. Raises ValueError: names the
    argument at fault."""
    check_pose(camera_from_world)
    if tuple(K.shape) != (3, 3):
        raise ValueError(f"rasterize: K: shape {tuple(K.shape)}, expected (3, 3)")
    (fx, skew, cx), (_, fy, cy) = K.detach().double().cpu()[:2].tolist()
    fine = all(abs(v) < LARGEST_PIXELS for v in (fx, fy, cx, cy))  # not so NaN
    if not fine or min(fx, fy) < 1 / LARGEST_PIXELS:
        raise ValueError(
            f"rasterize: K: focal lengths {fx}, {fy}, centre {cx}, {cy} make no camera"
        )
    if skew != 0:
        raise ValueError(f"rasterize: K: skew {skew} is not supported")
    if background is not None and tuple(background.shape) != (3,):
        raise ValueError(f"rasterize: background: shape {tuple(background.shape)}, expected (3,)")
    return RasterSettings(fx, fy, cx, cy, **numbers)


def check_pose(pose: Tensor, name: str = "camera_from_world") -> None:
    """Raise ValueError unless a pose (4, 4) is a rigid transform."""
    if tuple(pose.shape) != (4, 4):
        raise ValueError(f"rasterize: {name}: shape {tuple(pose.shape)}, expected (4, 4)")
    pose = pose.detach().double().cpu()
    if not bool(torch.isfinite(pose).all()):
        raise ValueError(f"rasterize: {name} is not finite")
    rotation = pose[:3, :3]
    skewed = (rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max() > 1e-3
    if skewed or pose[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError(f"rasterize: {name} is not a rigid transform")


def check_shapes(gaussians: Gaussians, device_type: str) -> None:
    """Check shapes, types and devices: the values are checked where they are read.

    Args:
        device_type: "cpu" or "cuda", where all fields must lie, on one device.

    Raises:
        ValueError: names the field at fault.
    """
    if gaussians.sh.ndim != 3 or gaussians.sh.shape[1] not in (1, 4, 9, 16):
        raise ValueError(
            f"Gaussians.sh: shape {tuple(gaussians.sh.shape)}, expected (N, 1|4|9|16, 3)"
        )
    for name, shape in gaussians.expected_shapes().items():
        value: Tensor = getattr(gaussians, name)
        if tuple(value.shape) != shape:
            raise ValueError(f"Gaussians.{name}: shape {tuple(value.shape)}, expected {shape}")
        if value.device.type != device_type or value.device != gaussians.means.device:
            wanted = gaussians.means.device if name != "means" else device_type
            raise ValueError(f"Gaussians.{name}: on {value.device}, expected on {wanted}")
        if value.dtype != gaussians.means.dtype or not value.is_floating_point():
            raise ValueError(
                f"Gaussians.{name}: dtype {value.dtype}, expected that of the means, floating point"
            )


@dataclass(frozen=True)
class ProjectedSplats:
    """The M visible Gaussians projected to the image, nearest first.

    Attributes: ids (M,) rows of the Gaussians; means2d (M, 2) px; conics (M, 3) entries xx, xy, yy
    of the inverse 2D covariance; opacities (M,); channels (M, 4) colour and depth; extents (M, 2)
    half widths of the box outside of which alpha < 1/255, px.
    """

    ids: Tensor
    means2d: Tensor
    conics: Tensor
    opacities: Tensor
    channels: Tensor
    extents: Tensor


def rasterize_reference(
    gaussians: Gaussians,
    camera_from_world: Tensor,
    settings: RasterSettings,
    background: Tensor | None,
) -> Rasterization:
    """Render by dense compositing in tiles; arguments as `rasterize`, checked by it."""
    gaussians.validate()
    n = len(gaussians)
    splats = project(gaussians, camera_from_world.to(gaussians.means), settings)

    meta = RasterMeta(
        visible=torch.zeros(n, dtype=torch.bool).index_fill_(0, splats.ids, True),
        radii=torch.zeros(n).index_copy_(
            0, splats.ids, splats.extents.amax(dim=1).ceil().detach().float()
        ),
        means2d=torch.zeros(n, 2).index_copy_(0, splats.ids, splats.means2d.detach().float()),
    )
    sizes = torch.zeros_like(splats.means2d.detach()) if settings.absgrad else None
    if splats.means2d.requires_grad:

        def keep_gradient(gradient: Tensor) -> None:
            meta.means2d_grad = torch.zeros(n, 2).index_copy_(0, splats.ids, gradient.float())
            if sizes is not None:  # all tiles have added theirs by now
                meta.means2d_absgrad = torch.zeros(n, 2).index_copy_(0, splats.ids, sizes.float())
                sizes.zero_()

        splats.means2d.register_hook(keep_gradient)

    rows = []
    # Tiles of the whole image: a pixel is the same sum in every window.
    left, top, right, bottom = settings.drawn
    first_x, first_y = left // TILE * TILE, top // TILE * TILE
    for y in range(first_y, bottom, TILE):
        row = [tile(splats, x, y, settings, sizes) for x in range(first_x, right, TILE)]
        rows.append(torch.cat(row, dim=1))
    image = torch.cat(rows, dim=0)[
        top - first_y : bottom - first_y, left - first_x : right - first_x
    ]
    rgb, depth, alpha = image[..., :3], image[..., 3], image[..., 4]
    if background is not None:
        rgb = rgb + (1 - alpha[..., None]) * background.to(rgb)
    return Rasterization(rgb, depth, alpha, meta)


def project(
    gaussians: Gaussians, camera_from_world: Tensor, settings: RasterSettings
) -> ProjectedSplats:
    """Project, colour, cull and sort by depth."""
    with torch.no_grad():
        ids = _visible(gaussians, camera_from_world, settings)
    # What is not drawn takes no part in the graph: some of it has derivatives that are not finite.
    g = gaussians.select(ids)
    image = _project(g, camera_from_world, settings)
    covariance = image.covariance
    conics = (
        torch.stack([covariance[:, 1, 1], -covariance[:, 0, 1], covariance[:, 0, 0]], dim=-1)
        / image.determinant[:, None]
    )
    # -R^T t is the camera centre of a rigid pose; its derivative is taken in this form.
    rotation, translation = camera_from_world[:3, :3], camera_from_world[:3, 3]
    directions = torch.nn.functional.normalize(g.means + translation @ rotation, dim=-1)
    colours = (evaluate_harmonics(g.sh, directions) + 0.5).clamp(min=0)
    return ProjectedSplats(
        ids=ids,
        means2d=image.means2d,
        conics=conics,
        opacities=image.opacities,
        channels=torch.cat([colours, image.depths[:, None]], dim=1),
        extents=_extents(image).detach(),
    )


@dataclass(frozen=True)
class _Image:
    """Projected Gaussians (M): centres (M, 2) px, depths, covariances (M, 2, 2) px^2, opacities."""

    means2d: Tensor
    depths: Tensor
    covariance: Tensor
    determinant: Tensor
    opacities: Tensor


def _project(g: Gaussians, camera_from_world: Tensor, settings: RasterSettings) -> _Image:
    rotation, translation = camera_from_world[:3, :3], camera_from_world[:3, 3]
    centres = g.means @ rotation.T + translation
    x, y, z = centres.unbind(-1)
    means2d = torch.stack(
        [settings.fx * x / z + settings.cx, settings.fy * y / z + settings.cy], dim=-1
    )
    axes = quat_to_matrix(g.quats) * g.log_scales.exp()[:, None, :]
    camera_axes = _jacobian(centres, settings) @ rotation @ axes
    exact = camera_axes @ camera_axes.transpose(1, 2)
    covariance = exact + settings.eps2d * torch.eye(2, dtype=exact.dtype)
    determinant = torch.linalg.det(covariance)
    opacities = g.logit_opacities.sigmoid()
    if settings.antialiased:
        # The low-pass filter widens a Gaussian; its opacity is lowered to keep the integral.
        ratio = _determinant(exact) / determinant
        opacities = opacities * ratio.clamp(min=1e-12).sqrt()
    return _Image(means2d, z, covariance, determinant, opacities)


def _determinant(matrix: Tensor) -> Tensor:
    # Unlike that of torch.linalg.det, its derivative is finite where the matrix is singular.
    return matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0]


def _extents(image: _Image) -> Tensor:
    # alpha = o exp(-q / 2) >= 1/255 inside an ellipse q <= 2 ln(255 o), boxed by its half widths.
    reach = 2 * (image.opacities / ALPHA_THRESHOLD).clamp(min=1).log()
    return (reach[:, None] * torch.diagonal(image.covariance, dim1=1, dim2=2)).sqrt()


def _visible(gaussians: Gaussians, camera_from_world: Tensor, settings: RasterSettings) -> Tensor:
    """Rows that touch the image, nearest first."""
    depths = gaussians.means @ camera_from_world[2, :3] + camera_from_world[2, 3]
    ids = ((depths >= settings.near) & (depths <= settings.far)).nonzero()[:, 0]
    image = _project(gaussians.select(ids), camera_from_world, settings)
    extents = _extents(image)
    low, high = image.means2d - extents, image.means2d + extents
    begin, end = torch.tensor(settings.drawn, dtype=low.dtype).unflatten(0, (2, 2))
    # Pixel centres are at begin + 0.5 .. end - 0.5.
    inside = ((high > begin + 0.5) & (low < end - 0.5)).all(dim=1)
    sized = (image.determinant > 0) & (image.determinant < LARGEST_DETERMINANT)
    kept = (inside & sized & (image.opacities >= ALPHA_THRESHOLD)).nonzero()[:, 0]
    return ids[kept[image.depths[kept].argsort(stable=True)]]


def _jacobian(centres: Tensor, settings: RasterSettings) -> Tensor:
    """d pixel / d camera point (M, 2, 3), at the centre moved to the edge of a widened view.

    Far outside of the image the linearisation explodes, so 3DGS clamps the point it is taken at.
    """
    x, y, z = centres.unbind(-1)

    def clamped(value: Tensor, focal: float, centre: float, size: int) -> Tensor:
        margin = TANGENT_MARGIN * 0.5 * size / focal
        return z * (value / z).clamp(-(centre / focal + margin), (size - centre) / focal + margin)

    tx = clamped(x, settings.fx, settings.cx, settings.width)
    ty = clamped(y, settings.fy, settings.cy, settings.height)
    zero = torch.zeros_like(z)
    rows = [
        torch.stack([settings.fx / z, zero, -settings.fx * tx / (z * z)], dim=-1),
        torch.stack([zero, settings.fy / z, -settings.fy * ty / (z * z)], dim=-1),
    ]
    return torch.stack(rows, dim=1)


def tile(
    splats: ProjectedSplats,
    left: int,
    top: int,
    settings: RasterSettings,
    sizes: Tensor | None = None,
) -> Tensor:
    """Composite one tile: (h, w, 5) with channels rgb, depth, alpha.

    Args:
        sizes: (M, 2), to which the backward pass adds the absolute values of d loss / d means2d of
            every pixel, component by component.
    """
    width, height = min(TILE, settings.width - left), min(TILE, settings.height - top)
    dtype = splats.means2d.dtype
    low, high = splats.means2d - splats.extents, splats.means2d + splats.extents
    corner = torch.tensor([left, top], dtype=dtype)
    far_corner = corner + torch.tensor([width, height], dtype=dtype)
    near = ((high > corner) & (low < far_corner)).all(dim=1).nonzero()[:, 0]

    ys = torch.arange(height, dtype=dtype) + (top + 0.5)
    xs = torch.arange(width, dtype=dtype) + (left + 0.5)
    pixels = torch.stack(torch.meshgrid(xs, ys, indexing="xy"), dim=-1).reshape(-1, 1, 2)
    centres = splats.means2d[near].expand(len(pixels), -1, -1)
    if sizes is not None and centres.requires_grad:

        def add_sizes(gradient: Tensor) -> None:  # (pixels, near, 2)
            sizes.index_add_(0, near, gradient.abs().sum(dim=0))

        centres.register_hook(add_sizes)
    dx, dy = (pixels - centres).unbind(-1)
    xx, xy, yy = splats.conics[near].unbind(-1)
    sigma = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy
    alpha = (splats.opacities[near] * (-sigma).exp()).clamp(max=settings.max_alpha)
    alpha = torch.where(alpha >= ALPHA_THRESHOLD, alpha, 0)
    after = (1 - alpha).cumprod(dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    weights = torch.where(after > TRANSMITTANCE_THRESHOLD, alpha * before, 0)
    channels = torch.cat([splats.channels[near], torch.ones(len(near), 1, dtype=dtype)], dim=1)
    return (weights @ channels).reshape(height, width, 5)
