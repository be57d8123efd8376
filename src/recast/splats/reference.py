"""The readable rasterizer: 3D Gaussian splatting in plain torch, differentiated by autograd.

Every formula of the native kernel is here in its simplest form; the tests compare the two,
gradients included. It works in the dtype of the Gaussians, and is hundreds of times slower than the
kernel. Sources: Zwicker et al. 2001 (EWA splatting), Kerbl et al. 2023 (3DGS), Yu et al. 2024
(Mip-Splatting, the opacity compensation).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from recast.splats import sh as harmonics
from recast.splats.gaussians import Gaussians, quat_to_matrix
from recast.splats.rasterization import (
    ALPHA_THRESHOLD,
    LARGEST_DETERMINANT,
    TANGENT_MARGIN,
    TILE,
    TRANSMITTANCE_THRESHOLD,
    Rasterization,
    RasterMeta,
    RasterSettings,
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
    colours = (harmonics.evaluate(g.sh, directions) + 0.5).clamp(min=0)
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
