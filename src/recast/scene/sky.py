"""The sky: an equirectangular colour map at infinity, seen where Gaussians let light through.

As a file it is an equirectangular image, zenith in the top row, azimuth from -pi to pi. Cubemaps
have the faces +x, -x, +y, -y, +z, -z, addressed as OpenGL does it (and nvdiffrast, which both
published trainers use): a texel gx to the right and gy down, both in [-1, 1], lies in direction
(1, -gy, -gx), (-1, -gy, gx), (gx, 1, gy), (gx, -1, -gy), (gx, -gy, 1), (-gx, -gy, -1).
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import write_bytes
from recast.core.images import decode_image
from recast.kernel import KernelSky, library
from recast.splats.native.rasterizer import empty, takes

HEIGHT, WIDTH = 128, 512
NODE_PX = 8
OPAQUE = 1.0 - 1.0 / 255.0
"""Pixels more opaque than this show no sky: what is lost is below one grey level."""
MOST_PIXELS = 1 << 25
"""Most pixels of a sky image: 8192 x 4096, 0.04 degrees a column."""
MAX_WIDTH = 2048
"""Pixels of the map made: 0.18 degrees a column, 25 MB."""
FINER = 2
"""Samples a cell along each axis, whose mean its colour is."""
_AXES = (
    (0, 2, 1, -1, -1),
    (0, 2, 1, 1, -1),
    (1, 0, 2, 1, 1),
    (1, 0, 2, 1, -1),
    (2, 0, 1, 1, -1),
    (2, 0, 1, -1, -1),
)
"""By face: the axis it faces, the axes of gx and gy, and their signs."""


@dataclass(frozen=True)
class SkyMap:
    """Colour by direction.

    Attributes:
        colours: (H, W, 3) float32 in [0, 1]. Rows run from the zenith down to the nadir, columns
            from azimuth -pi (counter-clockwise seen from above, 0 along world x) to pi, cell
            centres at +0.5; the first and the last column are neighbours.
    """

    colours: Tensor

    def validate(self) -> None:
        """Raise ValueError for another shape or type, or a colour outside of [0, 1]."""
        shape = tuple(self.colours.shape)
        if len(shape) != 3 or shape[2] != 3 or 0 in shape or self.colours.dtype != torch.float32:
            raise ValueError(f"sky: expected (H, W, 3) float32, got {shape} {self.colours.dtype}")
        if not bool(((self.colours >= 0) & (self.colours <= 1)).all()):  # also NaN
            raise ValueError("sky: holds a colour outside of [0, 1]")

    @classmethod
    def constant(cls, colour: Tensor, height: int = HEIGHT, width: int = WIDTH) -> SkyMap:
        """One colour (3,) everywhere."""
        return cls(colour.to(torch.float32).expand(height, width, 3).clone())

    def __call__(self, directions: Tensor) -> Tensor:
        """Colours (M, 3) in world directions (M, 3) of any length, bilinear."""
        return _sample(self.colours, direction_coordinates(directions))


def direction_coordinates(directions: Tensor) -> Tensor:
    """Place on the map of directions (..., 3): (..., 2) shares of its width and height.

    Width runs from azimuth -pi to pi, height from the zenith down.
    """
    x, y, z = directions.unbind(-1)
    azimuth = torch.atan2(y, x)
    elevation = torch.atan2(z, torch.sqrt(x * x + y * y))
    return torch.stack([azimuth / (2 * math.pi) + 0.5, 0.5 - elevation / math.pi], dim=-1)


def pixel_coordinates(camera: PinholeCamera, camera_from_world: ArrayLike) -> Tensor:
    """`direction_coordinates` of all pixels (H, W, 2) float32 of a rectified camera.

    Azimuth and elevation bend little across a few pixels: they are computed on every eighth and
    interpolated (error below a hundredth of a cell at driving cameras' focal lengths).

    Raises:
        ValueError: the camera has distortion.
    """
    if not camera.is_rectified:
        raise ValueError("the sky needs a rectified camera: use camera.rectified()")
    axes = np.asarray(camera_from_world, np.float64)[:3, :3]  # rows: camera axes in the world
    # A rim of one more node: cv2.resize repeats the outermost nodes instead of going on.
    columns, rows = -(-camera.width // NODE_PX), -(-camera.height // NODE_PX)
    u = (np.arange(-1, columns + 1) + 0.5) * NODE_PX
    v = (np.arange(-1, rows + 1) + 0.5) * NODE_PX
    along = ((u - camera.cx) / camera.fx)[None, :, None] * axes[0]
    down = ((v - camera.cy) / camera.fy)[:, None, None] * axes[1]
    directions = torch.from_numpy(along + down + axes[2])
    nodes = direction_coordinates(directions).numpy()
    # Unroll the turn from pi to -pi about the middle of the image.
    nodes[..., 0] -= np.rint(nodes[..., 0] - nodes[rows // 2, columns // 2, 0])
    size = ((columns + 2) * NODE_PX, (rows + 2) * NODE_PX)
    fine = cv2.resize(nodes.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    inner = fine[NODE_PX : NODE_PX + camera.height, NODE_PX : NODE_PX + camera.width]
    return torch.from_numpy(np.ascontiguousarray(inner))


def composite(rgb: Tensor, alpha: Tensor, colours: Tensor, coordinates: Tensor) -> Tensor:
    """Put the sky behind a rendered image: rgb + (1 - alpha) sky.

    Args:
        rgb: (H, W, 3) premultiplied colour on black.
        alpha: (H, W) accumulated opacity.
        colours: (h, w, 3) the sky map's.
        coordinates: (H, W, 2) as `pixel_coordinates` gives.

    Returns:
        (H, W, 3), differentiable in all but the coordinates; pixels above `OPAQUE` are left alone.
    """
    flat = alpha.reshape(-1)
    shown = (flat.detach() < OPAQUE).nonzero()[:, 0]
    sky = _sample(colours, coordinates.reshape(-1, 2).to(shown.device)[shown])
    through = 1 - flat.index_select(0, shown)
    return rgb.reshape(-1, 3).index_add(0, shown, through[:, None] * sky).view_as(rgb)


def _sample(colours: Tensor, coordinates: Tensor) -> Tensor:
    """Bilinear colours (M, 3) at map shares (M, 2); columns wrap around, rows end."""
    width = colours.shape[1]
    ring = torch.cat([colours[:, -1:], colours, colours[:, :1]], dim=1)
    across = (coordinates[:, 0] % 1.0 * width + 1) / (width + 2)
    grid = 2 * torch.stack([across, coordinates[:, 1]], dim=-1) - 1
    sampled = functional.grid_sample(
        ring.movedim(-1, 0)[None],
        grid[None, None].to(colours.dtype),
        padding_mode="border",
        align_corners=False,
    )
    return sampled[0, :, 0].T


def sky_from_pixels(directions: NDArray[np.float32], colours: NDArray[np.float32]) -> SkyMap:
    """A first map: the mean colour of the sky pixels seen in each cell, spread where none was.

    Args:
        directions: (M, 3) directions of sky pixels over all images; none makes a light grey sky.
        colours: (M, 3) colours of these pixels.
    """
    if len(directions) == 0:
        return SkyMap.constant(torch.full((3,), 0.8))
    height, width = HEIGHT, WIDTH
    place = direction_coordinates(torch.from_numpy(directions)).numpy()
    column = np.minimum((place[:, 0] * width).astype(np.int64), width - 1)
    row = np.minimum((place[:, 1] * height).astype(np.int64), height - 1)
    nearest = row * width + column
    count = np.bincount(nearest, minlength=height * width).astype(np.float64)
    sums = [np.bincount(nearest, colours[:, c], minlength=height * width) for c in range(3)]
    total = np.stack(sums, axis=-1).astype(np.float64)
    filled = _spread(total.reshape(height, width, 3), count.reshape(height, width))
    return SkyMap(torch.from_numpy(filled.astype(np.float32)).clamp(0, 1))


def _spread(total: NDArray[np.float64], count: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalised convolution with growing windows until every cell has a colour."""
    mean = total.reshape(-1, 3).sum(0) / count.sum()
    result = np.broadcast_to(mean, total.shape).copy()
    width = count.shape[1]
    sigma = max(count.shape) / 8
    while sigma > 0.3:
        pad = min(width, int(3 * sigma) + 1)
        wide_total = np.concatenate([total[:, -pad:], total, total[:, :pad]], axis=1)
        wide_count = np.concatenate([count[:, -pad:], count, count[:, :pad]], axis=1)
        blurred = cv2.GaussianBlur(wide_total, (0, 0), sigma)[:, pad : pad + width]
        weight = cv2.GaussianBlur(wide_count, (0, 0), sigma)[:, pad : pad + width]
        enough = weight > 0.3 * weight.max() * 1e-2
        result[enough] = (blurred / np.maximum(weight, 1e-12)[..., None])[enough]
        sigma /= 2
    seen = count > 0
    result[seen] = (total / np.maximum(count, 1)[..., None])[seen]
    return result


def write_sky(path: str | Path, sky: SkyMap) -> None:
    """Write a PNG with 16 bits a channel, in which no colour is off by more than 1e-5."""
    levels = np.rint(sky.colours.clamp(0, 1).numpy() * 65535).astype(np.uint16)
    _, data = cv2.imencode(".png", levels[..., ::-1])
    write_bytes(path, data.tobytes())


def read_sky(path: str | Path) -> SkyMap:
    """Read an RGB image of 8 or 16 bits a channel.

    Raises:
        InputError: the file is missing, no image, too large, or of another kind.
    """
    path = Path(path)
    pixels = decode_image(path, path, most_pixels=MOST_PIXELS, what="sky image")
    if pixels.shape[2:] != (3,):
        raise InputError(path, "sky image", f"is {pixels.shape}", "write RGB of 8 or 16 bits")
    colours = pixels.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    return SkyMap(torch.from_numpy(colours))


def sample_cubemap(faces: Tensor, directions: Tensor) -> Tensor:
    """Colours (M, 3) of faces (6, R, R, 3) in directions (M, 3) of any length.

    Bilinear within a face and held at its rim; seamless filtering differs there, by half a texel.
    Differentiable in the faces.
    """
    major = directions.abs().argmax(dim=1)
    chosen = directions.gather(1, major[:, None])[:, 0]
    face = 2 * major + (chosen < 0)
    colours = directions.new_empty(len(directions), 3)
    maps = faces.to(directions.dtype).movedim(-1, 1).unbind()
    for index, (axis, across, down, sign_x, sign_y) in enumerate(_AXES):
        rows = (face == index).nonzero()[:, 0]
        if len(rows) == 0:
            continue
        own = directions[rows] / directions[rows, axis].abs()[:, None]
        grid = torch.stack([sign_x * own[:, across], sign_y * own[:, down]], dim=-1)
        sampled = functional.grid_sample(
            maps[index][None],
            grid[None, None],
            padding_mode="border",
            align_corners=False,
        )
        colours[rows] = sampled[0, :, 0].T
    return colours


def texel_directions(size: int) -> Tensor:
    """Directions (6, R, R, 3) of the texels' centres, of any length, for faces of R = `size`."""
    centres = (torch.arange(size) + 0.5) / size * 2 - 1
    down, across = torch.meshgrid(centres, centres, indexing="ij")
    directions = torch.empty(6, size, size, 3)
    for index, (axis, axis_x, axis_y, sign_x, sign_y) in enumerate(_AXES):
        directions[index, ..., axis] = 1 - 2 * (index % 2)
        directions[index, ..., axis_x] = sign_x * across
        directions[index, ..., axis_y] = sign_y * down
    return directions


def sky_from_cubemap(faces: Tensor | None, cube_from_world: Tensor) -> SkyMap:
    """Resample a cubemap.

    Args:
        faces: (6, R, R, 3), or None for a black sky.
        cube_from_world: (3, 3) rotation (or exchange of axes) of directions.

    Returns:
        A map as wide as four faces, at most `MAX_WIDTH`, clamped to [0, 1].
    """
    if faces is None:
        return SkyMap.constant(torch.zeros(3))
    width = min(4 * faces.shape[1], MAX_WIDTH)
    height = max(width // 2, 1)
    turn = cube_from_world.to(torch.float32).T
    columns = (torch.arange(width * FINER) + 0.5) / (width * FINER)
    azimuth = (columns - 0.5) * (2 * math.pi)
    colours = torch.empty(height, width, 3)
    for row in range(height):
        shares = (row + (torch.arange(FINER) + 0.5) / FINER) / height
        elevation = ((0.5 - shares) * math.pi)[:, None]
        directions = torch.stack(
            [
                elevation.cos() * azimuth.cos(),
                elevation.cos() * azimuth.sin(),
                elevation.sin().expand(FINER, len(azimuth)),
            ],
            dim=-1,
        )
        fine = sample_cubemap(faces, directions.reshape(-1, 3) @ turn)
        colours[row] = fine.view(FINER, width, FINER, 3).mean(dim=(0, 2))
    return SkyMap(colours.clamp(0, 1))


def fused_composite(rgb: Tensor, alpha: Tensor, colours: Tensor, coordinates: Tensor) -> Tensor:
    """As `sky.composite`, by the compiled kernel for float32 on the CPU and by that for all else.

    Raises:
        ValueError: the shapes do not belong together.
    """
    given = rgb, alpha, colours, coordinates
    shapes = tuple(tuple(one.shape) for one in given)
    size = shapes[1]
    fine = len(size) == 2 and (shapes[0], shapes[3]) == ((*size, 3), (*size, 2))
    if not fine or len(shapes[2]) != 3 or shapes[2][2] != 3 or colours.numel() == 0:
        raise ValueError(f"fused_composite: image, opacity, sky, coordinates of shapes {shapes}")
    if takes(*given):
        return _Fused.apply(*(one.contiguous() for one in given))
    return composite(*given)


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, rgb: Tensor, alpha: Tensor, colours: Tensor, coordinates: Tensor
    ) -> Tensor:
        image = empty(*rgb.shape)
        call = _call(alpha, colours, coordinates)
        call.rgb, call.image = rgb.data_ptr(), image.data_ptr()
        library().recast_sky(ctypes.byref(call))
        ctx.save_for_backward(alpha, colours, coordinates)
        return image

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, image_grad: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        alpha, colours, coordinates = ctx.saved_tensors
        given = image_grad.contiguous()
        alpha_grad, colours_grad = empty(*alpha.shape), torch.zeros_like(colours)
        call = _call(alpha, colours, coordinates)
        call.image_grad = given.data_ptr()
        call.alpha_grad, call.colours_grad = alpha_grad.data_ptr(), colours_grad.data_ptr()
        library().recast_sky_backward(ctypes.byref(call))
        return image_grad, alpha_grad, colours_grad, None


def _call(alpha: Tensor, colours: Tensor, coordinates: Tensor) -> KernelSky:
    return KernelSky(
        alpha=alpha.data_ptr(),
        colours=colours.data_ptr(),
        coordinates=coordinates.data_ptr(),
        pixels=alpha.numel(),
        height=colours.shape[0],
        width=colours.shape[1],
        opaque=OPAQUE,
    )
