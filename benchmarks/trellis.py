"""Speed of the image-to-3D model's parts on a car-like surface, next to the simplest torch.

    python benchmarks/trellis.py sparse              # the whole table, some minutes
    python benchmarks/trellis.py sparse --counts 1000 --channels 64
    python benchmarks/trellis.py actor               # a small model, from crop to Gaussians

All times are CPU milliseconds of the process on one thread, minimum of the repeats, so that other
work on the machine disturbs little; both versions take turns, so that ratios compare like with
like.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import max_pool3d

from recast.trellis import ImageTo3D
from recast.trellis.checkpoint_sizes import SMALL, new_checkpoint
from recast.trellis.generate import Stopwatch
from recast.trellis.sparse import (
    OFFSETS,
    SparseTensor,
    WindowedTokens,
    attention_reference,
    neighbour_map,
    window_partition,
)
from recast.trellis.sparse_convolution import submanifold_convolution
from recast.trellis.vae import SLatEncoder, SparseStructureEncoder

HEAD_CHANNELS = 32
WINDOW, SHIFT = 8, 4


def car_surface(count: int) -> Tensor:
    """(count,3) int32 voxels of a car's surface: a rounded body with a cabin, the longest side x.

    The resolution is the smallest that has as many voxels; some are left out at random.
    """
    low, high = 8, 256
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if len(_surface(middle)) < count else (low, middle)
    voxels = _surface(high)
    keep = torch.randperm(len(voxels), generator=torch.Generator().manual_seed(0))[:count]
    return voxels[keep.sort().values].int()


def _surface(resolution: int) -> Tensor:
    axis = (torch.arange(resolution) + 0.5) / resolution - 0.5
    x, y, z = torch.meshgrid(axis, axis, axis, indexing="ij")
    body = (x / 0.5) ** 6 + (y / 0.21) ** 6 + ((z + 0.05) / 0.1) ** 6 < 1
    cabin = ((x + 0.03) / 0.28) ** 4 + (y / 0.18) ** 4 + ((z - 0.07) / 0.11) ** 4 < 1
    solid = body | cabin
    near_outside = max_pool3d((~solid)[None].float(), 3, stride=1, padding=1)[0] > 0
    return torch.nonzero(solid & near_outside)


def plain_convolution(x: SparseTensor, weight: Tensor, table: Tensor) -> Tensor:
    """The simplest correct torch: gather all 27 neighbours, absent ones as zeros; multiply."""
    padded = torch.cat([x.feats, x.feats.new_zeros(1, x.feats.shape[1])])
    return padded[table].flatten(1) @ weight.flatten(1).T


def neighbour_table(x: SparseTensor) -> Tensor:
    """(T,27) rows of the neighbours through a dictionary; T where there is none."""
    row_of = {tuple(voxel): row for row, voxel in enumerate(x.coords.tolist())}
    return torch.tensor(
        [
            [row_of.get((b, i + di, j + dj, k + dk), len(row_of)) for di, dj, dk in OFFSETS]
            for b, i, j, k in row_of
        ]
    )


def plain_windows(windows: list[Tensor], q: Tensor, k: Tensor, v: Tensor) -> Tensor:
    """The simplest correct torch: one window after another, weights written out."""
    out = torch.zeros_like(q)
    for rows in windows:
        out[rows] = attention_reference(q[rows], k[rows], v[rows])
    return out


def milliseconds(run: Callable[[], object], repeats: int) -> float:
    best = float("inf")
    for _ in range(repeats):
        start = time.process_time()
        run()
        best = min(best, time.process_time() - start)
    return 1e3 * best


def compare(name: str, fast: Callable[[], Tensor], plain: Callable[[], Tensor], n: int) -> None:
    """One row of the table: forward, and forward with backward, of both versions."""
    with torch.no_grad():
        difference = float((fast() - plain()).abs().max() / plain().abs().max())
        forward = [milliseconds(f, n) for f in (fast, plain)]
    both = [milliseconds(lambda f=f: f().sum().backward(), n) for f in (fast, plain)]
    cells = [f"{a:9.1f} {b:9.1f} {b / a:6.2f}" for a, b in (forward, both)]
    print(f"{name:<44} {cells[0]}   {cells[1]}   {difference:.0e}", flush=True)


def convolutions(x: SparseTensor, table: Tensor, width: int, repeats: int) -> None:
    generator = torch.Generator().manual_seed(width)
    feats = torch.randn(len(x.coords), width, generator=generator, requires_grad=True)
    weight = torch.randn(width, 3, 3, 3, width, generator=generator, requires_grad=True)
    wide = x.with_feats(feats)
    compare(
        f"  convolution, {width} channels",
        lambda: submanifold_convolution(wide, weight, None).feats,
        lambda: plain_convolution(wide, weight, table),
        repeats,
    )


def windowed_attention(x: SparseTensor, windows: list[Tensor], width: int, repeats: int) -> None:
    generator = torch.Generator().manual_seed(width)
    shape = (3, len(x.coords), width // HEAD_CHANNELS, HEAD_CHANNELS)
    q, k, v = torch.randn(*shape, generator=generator).requires_grad_().unbind()
    layout = WindowedTokens(x, WINDOW, SHIFT)
    compare(
        f"  windowed attention, {width} channels",
        lambda: layout.attend(q, k, v),
        lambda: plain_windows(windows, q, k, v),
        repeats,
    )


def fresh(voxels: Tensor) -> SparseTensor:
    """A tensor that has nothing in its cache."""
    return SparseTensor.stack([voxels], [torch.zeros(len(voxels), 0)])


def sparse(counts: list[int], channels: list[int], repeats: int) -> None:
    """Submanifold convolution and windowed attention, and what they derive from coordinates."""
    print("CPU ms: recast, simplest torch, ratio; forward, then forward and backward; difference\n")
    for count in counts:
        voxels = car_surface(count)
        x = fresh(voxels)
        pairs = 2 * sum(len(rows) for rows, _ in neighbour_map(x).pairs) / count + 1
        partition = window_partition(x, WINDOW, SHIFT)
        sizes = [size for number, size in partition.buckets for _ in range(number)]
        found = milliseconds(lambda v=voxels: neighbour_map(fresh(v)).table, repeats)
        split = milliseconds(lambda v=voxels: window_partition(fresh(v), WINDOW, SHIFT), repeats)
        print(
            f"{count} voxels: {pairs:.1f} of 27 neighbours exist, {len(sizes)} windows of "
            f"{count / len(sizes):.0f} voxels; neighbours {found:.1f} ms, windows {split:.1f} ms"
        )
        table, windows = neighbour_table(x), list(partition.order.split(sizes))
        for width in channels:
            convolutions(x, table, width, repeats)
        for width in channels:
            if width % HEAD_CHANNELS == 0:
                windowed_attention(x, windows, width, repeats)


def actor(steps: int, repeats: int) -> None:
    """One actor from one crop with the small model: its weights are random, its voxels a car's."""
    model = ImageTo3D(new_checkpoint(SMALL, seed=0))
    networks = [*model.checkpoint.models.values()]
    wanted = [m for m in networks if not isinstance(m, SparseStructureEncoder | SLatEncoder)]
    parameters = sum(p.numel() for m in wanted for p in m.parameters())
    resolution = model.latent_flow.config.resolution
    voxels = _surface(resolution).int()
    crop = np.full((128, 192, 4), 90, np.uint8)
    crop[..., 3] = 0
    crop[30:100, 20:170, 3] = 255
    settings = model.structure_settings.merged(steps=steps)
    print(
        f"{parameters / 1e6:.1f} M parameters, R = {resolution}, {len(voxels)} voxels, {steps} "
        "steps with guidance; CPU seconds on one thread"
    )
    for _ in range(repeats):
        watch = Stopwatch(model.device)
        start = time.process_time()
        with watch.stage("condition"):
            condition = model.condition([[crop]], ["crop"])
        with watch.stage("structure"):
            noise = torch.randn(1, *model.structure_shape)
            structure = model.sample_structure(noise, condition, settings)
            model.active_voxels(structure[0])
        with watch.stage("latent"):
            noise = torch.randn(len(voxels), model.latent_channels)
            latent = model.sample_latent([voxels], [noise], condition, settings)
        with watch.stage("decode"):
            (gaussians,) = model.decode(latent)
        stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in watch.seconds.items())
        print(
            f"{time.process_time() - start:.2f} s for {len(gaussians)} Gaussians (wall: {stages}); "
            f"peak {watch.peak_bytes() / 2**20:.0f} MiB"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="part", required=True)
    part = commands.add_parser("sparse", help="convolution and windowed attention")
    part.add_argument("--counts", type=int, nargs="+", default=[1000, 5000, 20000])
    part.add_argument("--channels", type=int, nargs="+", default=[32, 64, 128])
    part.add_argument("--repeats", type=int, default=5)
    part = commands.add_parser("actor", help="a small model from crop to Gaussians")
    part.add_argument("--steps", type=int, default=25)
    part.add_argument("--repeats", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.part == "sparse":
        sparse(arguments.counts, arguments.channels, arguments.repeats)
    else:
        actor(arguments.steps, arguments.repeats)


if __name__ == "__main__":
    main()
