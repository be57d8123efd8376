"""Speed and memory of the CPU rasterizer on a generated street, next to the torch reference.

    python benchmarks/raster.py                      # the whole table, some minutes
    python benchmarks/raster.py --counts 100000 --isas avx2 --no-reference
    python benchmarks/raster.py --against ../other-tree --counts 300000   # ratios to another build

All times are CPU milliseconds of the process, minimum of the repeats, so that other work on the
machine disturbs little; the kernels take turns, so that ratios compare like with like. The torch
reference is projected whole, but composited on a sample of the tiles and scaled up: whole images
would take minutes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from against import compare
from torch import Tensor

from recast.splats import Gaussians, RasterMeta, morton_order, native, rasterization, rasterize
from recast.splats.native.rasterizer import Workspace, empty, run_forward
from recast.splats.rasterization import TILE, RasterSettings

SIZES = ((320, 213), (960, 640))
FORWARD = ("project", "sort", "bin", "raster")
BACKWARD = ("raster_backward", "project_backward")
SAMPLE_TILES = 12
# x right, y down, z forward: the car looks along +x.
CAMERA = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def street(count: int, degree: int = 3, seed: int = 0) -> Gaussians:
    """A street of 150 m: ground 35 %, facades 45 %, objects 20 % of the Gaussians, Morton order."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(n: int, low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(n, generator=generator)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    ground, facade = int(0.35 * count), int(0.45 * count)
    objects = count - ground - facade
    start, end, boxes = -30.0, 120.0, 40
    side = torch.sign(uniform(facade, -1, 1))
    box = torch.randint(0, boxes, (objects,), generator=generator)
    box_x, box_y = uniform(boxes, start, end), uniform(boxes, -8, 8)
    means = torch.cat(
        [
            torch.stack(
                [
                    uniform(ground, start, end),
                    uniform(ground, -12, 12),
                    -1.6 + 0.01 * normal(ground),
                ],
                dim=1,
            ),
            torch.stack(
                [
                    uniform(facade, start, end),
                    side * uniform(facade, 10, 11.5),
                    uniform(facade, -1.6, 10.4),
                ],
                dim=1,
            ),
            torch.stack(
                [
                    box_x[box] + 1.2 * normal(objects),
                    box_y[box] + 0.7 * normal(objects),
                    -0.8 + 0.5 * normal(objects),
                ],
                dim=1,
            ),
        ]
    )
    # Square metres a Gaussian: they just cover their surface.
    length = end - start
    area = torch.cat(
        [
            torch.full((ground,), length * 24 / ground),
            torch.full((facade,), 2 * length * 12 / facade),
            torch.full((objects,), boxes * 30.0 / objects),
        ]
    )
    log_scales = (0.6 * area.sqrt()).log()[:, None] + 0.4 * normal(count, 3)
    log_scales[:, 2] -= 1.5
    quats = normal(count, 4)
    quats[:ground] = torch.tensor([1.0, 0, 0, 0]) + 0.05 * quats[:ground]
    quats[ground : ground + facade] = (
        torch.tensor([0.5**0.5, 0.5**0.5, 0, 0]) + 0.05 * quats[ground : ground + facade]
    )
    sh = 0.1 * normal(count, (degree + 1) ** 2, 3)
    sh[:, 0] *= 8
    gaussians = Gaussians(means, quats, log_scales, 1.5 * normal(count) + 1, sh)
    return gaussians.select(morton_order(means))


def view(width: int, height: int) -> tuple[Tensor, RasterSettings]:
    """Intrinsics with f = 700 px at 960 px of width, and the settings of `rasterize`'s defaults."""
    focal = 700 * width / 960
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    settings = RasterSettings(
        focal, focal, width / 2, height / 2, width, height, 0.2, 1e10, 0.3, False, 0.99
    )
    return K, settings


def least(into: dict[str, float], values: dict[str, float]) -> None:
    """Keep the smaller value of each name."""
    for name, value in values.items():
        into[name] = min(into.get(name, value), value)


def cpu_ms(work: Callable[[], object]) -> float:
    """CPU milliseconds of one call."""
    start = time.process_time()
    work()
    return (time.process_time() - start) * 1e3


@dataclass
class Measurement:
    """Stage times of inference and of a training step (with `torch`: seen from Python); MB held."""

    inference: dict[str, float]
    training: dict[str, float]
    megabytes: float = 0.0


def measure_native(
    gaussians: Gaussians, width: int, height: int, isas: list[str], repeats: int
) -> dict[str, Measurement]:
    """Measure each instruction set, in turns."""
    K, settings = view(width, height)
    n = len(gaussians)
    meta = RasterMeta(empty(n, dtype=torch.bool), empty(n), empty(n, 2))
    leaves = Gaussians(**{k: v.clone().requires_grad_() for k, v in vars(gaussians).items()})
    ones = torch.ones(height, width, 3), torch.ones(height, width), torch.ones(height, width)
    found = {isa: Measurement({}, {}) for isa in isas}
    for _ in range(repeats):
        for isa in isas:
            native.set_isa(isa)
            workspace = Workspace()
            parameters = tuple(vars(gaussians).values())
            run_forward(workspace, parameters, CAMERA, None, settings, meta, training=False)
            timings = {k: v for k, v in workspace.timings().items() if k in FORWARD}
            least(found[isa].inference, timings)
            del workspace

            start = time.process_time()
            image = rasterize(leaves, CAMERA, K, width, height, backend="native")
            workspace = image.rgb.grad_fn.workspace
            torch.autograd.backward([image.rgb, image.depth, image.alpha], ones)
            step = (time.process_time() - start) * 1e3
            least(found[isa].training, {**workspace.timings(), "torch": step})
            found[isa].megabytes = workspace.nbytes() / 1e6
            for leaf in vars(leaves).values():
                leaf.grad = None
            del workspace, image
    return found


def measure_reference(gaussians: Gaussians, width: int, height: int) -> tuple[float, float]:
    """CPU ms of a forward pass, and of forward and backward, scaled up from a sample of tiles."""
    _, settings = view(width, height)
    corners = [(x, y) for y in range(0, height, TILE) for x in range(0, width, TILE)]
    sample = corners[:: max(1, len(corners) // SAMPLE_TILES)]
    factor = len(corners) / len(sample)
    leaves = Gaussians(**{k: v.clone().requires_grad_() for k, v in vars(gaussians).items()})
    splats = rasterization.project(leaves, CAMERA, settings)
    cut = rasterization.ProjectedSplats(
        **{
            k: v.detach().requires_grad_() if v.is_floating_point() else v
            for k, v in vars(splats).items()
        }
    )
    outputs = (splats.means2d, splats.conics, splats.opacities, splats.channels)
    project_back = cpu_ms(
        lambda: torch.autograd.backward(outputs, [torch.ones_like(o) for o in outputs])
    )
    with torch.no_grad():
        project = cpu_ms(lambda: rasterization.project(gaussians, CAMERA, settings))
        tiles = cpu_ms(lambda: [rasterization.tile(cut, *corner, settings) for corner in sample])
    both = cpu_ms(
        lambda: [rasterization.tile(cut, *corner, settings).sum().backward() for corner in sample]
    )
    forward = project + factor * tiles
    return forward, project + project_back + factor * both


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--counts", type=int, nargs="+", default=[100_000, 300_000, 1_000_000])
    parser.add_argument("--isas", nargs="+", default=list(native.info().isas))
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=6)
    parser.add_argument("--reference", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--against", type=Path, help="a built tree of recast to compare with")
    options = parser.parse_args()
    if options.against is not None:
        for count in options.counts:
            print(f"{count} Gaussians, {options.threads} thread(s), CPU ms")
            fields, sizes = vars(street(count)), (*SIZES, (480, 320))
            compare(options.against, fields, sizes, options.isas, options.repeats, options.threads)
        return
    torch.set_num_threads(options.threads)
    native.set_threads(options.threads)

    print(f"CPU ms, minimum of {options.repeats} repeats, {options.threads} thread(s).")
    print(f"Reference: projected whole, composited on about {SAMPLE_TILES} tiles and scaled up.")
    print("step = training forward + raster backward + projection backward; torch = the same step")
    print("seen from Python. MB = working memory of a training step.\n")
    head = f"{'Gaussians':>9} {'image':>7} {'kernel':>9} |{'forward':>8}{'proj+SH':>8}{'sort':>6}"
    head += f"{'bin':>6}{'raster':>8} |{'step':>7} = fwd+ras+prj back{'torch':>8} |{'MB':>5}"
    head += f" | {'slower than ' + options.isas[0]}: fwd, step"
    print(head)
    for count in options.counts:
        gaussians = street(count)
        for width, height in SIZES:
            where = f"{count:>9} {width}x{height}"
            first: tuple[float, float] | None = None
            found = measure_native(gaussians, width, height, options.isas, options.repeats)
            for isa, measured in found.items():
                once, train = measured.inference, measured.training
                forward = sum(once[k] for k in FORWARD)
                train_forward = sum(train[k] for k in FORWARD)
                step = train_forward + sum(train[k] for k in BACKWARD)
                first = first or (forward, step)
                print(
                    f"{where} {isa:>9} |{forward:8.1f}{once['project']:8.1f}{once['sort']:6.1f}"
                    f"{once['bin']:6.1f}{once['raster']:8.1f} |{step:7.1f} = {train_forward:5.1f}"
                    f" +{train['raster_backward']:6.1f} +{train['project_backward']:6.1f}"
                    f"{train['torch']:8.1f} |{measured.megabytes:5.0f} |"
                    f"{forward / first[0]:7.1f}x {step / first[1]:6.1f}x",
                    flush=True,
                )
            if options.reference and first:
                forward, step = measure_reference(gaussians, width, height)
                print(
                    f"{where} reference |{forward:8.0f}{'':28} |{step:7.0f}{'':38} |"
                    f"{forward / first[0]:7.0f}x {step / first[1]:6.0f}x",
                    flush=True,
                )


if __name__ == "__main__":
    main()
