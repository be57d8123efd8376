"""Scenes on a GPU: training steps and rendered frames a second, memory, and the cost over gsplat.

    python benchmarks/cuda.py                          # 300k Gaussians, 3 cameras 960x640
    python benchmarks/cuda.py --gaussians 1000000 --steps 1000

A street is made up and drawn from three cameras at several places; those pictures, with depths, are
what the trainer then learns from half of the street's Gaussians, moved a little. The steps are the
whole of a scene's training: drawing, losses, backward pass, optimiser, density control.

Times are wall-clock, the device waited for at both ends. The rows over gsplat take turns and give
the median of the repeats; `direct` calls `gsplat.rasterization` with scales and opacities worked
out beforehand, `rasterize` is ours, with activations and checks.
"""

from __future__ import annotations

import argparse
import sys

if __name__ == "cuda":
    # NVIDIA's package has this name too, and torch asks for it: not this file is meant.
    raise ModuleNotFoundError("a benchmark, not NVIDIA's package cuda", name="cuda")
if __name__ == "__main__":
    # For the same reason this folder is the last to be looked through.
    sys.path.append(sys.path.pop(0))

from collections.abc import Callable, Sequence
from statistics import mean, median
from time import perf_counter

import numpy as np
import torch
from raster import CAMERA, street, view
from torch import Tensor

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.geometry import se3
from recast.reconstruction import SceneConfig
from recast.reconstruction.first_points import Initialisation
from recast.reconstruction.step import Trainer
from recast.reconstruction.views import DepthSamples, TrainingView
from recast.scene import StreetScene
from recast.scene.sky import SkyMap
from recast.scene.street_scene import SceneRasterizer
from recast.splats import Gaussians, pick_device, rasterize
from recast.splats.cuda import load_gsplat

HEADINGS = {"front": 0.0, "left": 0.9, "right": -0.9}
"""Cameras and their yaw, radians."""
DEPTHS = 8000
WARM_UP = 5
"""Steps and calls that are not timed: kernels are built and memory is found in them."""


def wait(device: torch.device) -> None:
    """Until all that was asked of the device is done."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def seconds(work: Callable[[], object], device: torch.device) -> float:
    """Wall-clock seconds of one call."""
    wait(device)
    start = perf_counter()
    work()
    wait(device)
    return perf_counter() - start


def poses(places: int) -> list[tuple[str, int, np.ndarray]]:
    """Camera, frame and `world_from_camera` (4, 4) of every view, from the street's start on."""
    ahead = np.linalg.inv(CAMERA.double().numpy())
    found = []
    for frame, x in enumerate(np.linspace(0.0, 60.0, places)):
        for name, yaw in HEADINGS.items():
            turn = se3.from_rotation_translation(se3.rotation_z(yaw), np.array([x, 0.0, 0.0]))
            found.append((name, frame, turn @ ahead))
    return found


def recordings(
    scene: StreetScene, camera: PinholeCamera, places: int, device: torch.device
) -> tuple[list[TrainingView], list[DepthSamples]]:
    """Pictures of the street, and depths at random pixels of what is solid in them."""
    rasterizer = SceneRasterizer(scene, str(device))
    rng = np.random.default_rng(0)
    views, depths = [], []
    for name, frame, pose in poses(places):
        drawn = rasterizer.render(camera, se3.inverse(pose), {})
        picture = np.rint(drawn.rgb * 255).astype(np.uint8)
        views.append(TrainingView(name, frame, frame * 100_000, camera, pose, picture, None, False))
        rows, columns = np.nonzero(drawn.alpha > 0.98)
        chosen = rng.permutation(len(rows))[:DEPTHS]
        rows, columns = rows[chosen], columns[chosen]
        measured = drawn.depth[rows, columns] / drawn.alpha[rows, columns]
        uv = np.stack([columns, rows], axis=-1).astype(np.float32) + np.float32(0.5)
        depths.append(DepthSamples(measured, uv))
    return views, depths


def worse(gaussians: Gaussians) -> Gaussians:
    """Every second of a street's Gaussians, larger, moved by some centimetres, grey."""
    half = gaussians.select(torch.arange(0, len(gaussians), 2))
    generator = torch.Generator().manual_seed(1)
    return Gaussians(
        means=half.means + 0.05 * torch.randn(half.means.shape, generator=generator),
        quats=half.quats,
        log_scales=half.log_scales + 0.35,
        logit_opacities=half.logit_opacities,
        sh=0.2 * half.sh,
    )


def train(
    views: list[TrainingView], start: Initialisation, steps: int, device: torch.device
) -> dict[str, float]:
    """Train; steps a second, PSNR of the views of the first and of the last steps, Gaussians."""
    config = SceneConfig(
        iterations=WARM_UP + steps, coarse_fraction=0.0, max_gaussians=2 * len(start.background)
    )
    trainer = Trainer(config, views, {}, start, device)
    first = mean(trainer.step().psnr for _ in range(WARM_UP))
    reports = []
    took = seconds(lambda: reports.extend(trainer.step().psnr for _ in range(steps)), device)
    return {
        "steps": steps / took,
        "first": first,
        "last": mean(reports[-min(len(views), steps) :]),
        "gaussians": trainer.model.count_rows(),
    }


def draw(
    scene: StreetScene, camera: PinholeCamera, repeats: int, device: torch.device
) -> tuple[float, float]:
    """Seconds for the three cameras of one moment: left on the device, and as uint8 on the CPU."""
    rasterizer = SceneRasterizer(scene, str(device))
    cameras = [se3.inverse(pose) for _, _, pose in poses(1)]

    def stay() -> None:
        for pose in cameras:
            rasterizer.draw(camera, pose, {})

    def fetch() -> None:
        for pose in cameras:
            rgb = rasterizer.draw(camera, pose, {}).rgb
            (rgb * 255).round().to(torch.uint8).cpu()

    times = [(seconds(stay, device), seconds(fetch, device)) for _ in range(WARM_UP + repeats)]
    there, here = zip(*times[WARM_UP:], strict=True)
    return median(there), median(here)


def over_gsplat(
    gaussians: Gaussians, size: Sequence[int], repeats: int, device: torch.device
) -> dict[str, float]:
    """Median seconds: gsplat directly and `rasterize`, forward, and forward with backward."""
    gsplat = load_gsplat()
    width, height = size
    K = view(width, height)[0]
    there = gaussians.to(device)
    leaves = Gaussians(**{k: v.clone().requires_grad_() for k, v in vars(there).items()})
    activated = {
        "means": there.means,
        "quats": there.quats,
        "scales": there.log_scales.exp(),
        "opacities": there.logit_opacities.sigmoid(),
        "colors": there.sh,
    }
    direct_leaves = {k: v.clone().requires_grad_() for k, v in activated.items()}
    pose = CAMERA.to(device)

    def directly(tensors: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        image, alpha, _ = gsplat.rasterization(
            **tensors,
            viewmats=pose[None],
            Ks=K.to(device)[None],
            width=width,
            height=height,
            near_plane=0.2,
            sh_degree=gaussians.sh_degree,
            packed=False,
            render_mode="RGB+D",
        )
        return image, alpha

    def direct_step() -> None:
        image, alpha = directly(direct_leaves)
        (image.sum() + alpha.sum()).backward()

    def our_step() -> None:
        image = rasterize(leaves, CAMERA, K, width, height, backend="gsplat")
        (image.rgb.sum() + image.depth.sum() + image.alpha.sum()).backward()

    works: dict[str, Callable[[], object]] = {
        "direct forward": lambda: directly(activated),
        "rasterize forward": lambda: rasterize(there, CAMERA, K, width, height, backend="gsplat"),
        "direct step": direct_step,
        "rasterize step": our_step,
    }
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(WARM_UP + repeats):
        for name, work in works.items():
            times[name].append(seconds(work, device))
    return {name: median(found[WARM_UP:]) for name, found in times.items()}


def measure(options: argparse.Namespace, device: torch.device) -> None:
    """Print all figures of one device."""
    torch.backends.cudnn.allow_tf32 = False  # as in `train_scene`
    width, height = options.size
    found = torch.cuda.get_device_name(device) if device.type == "cuda" else "no GPU"
    version = getattr(load_gsplat(), "__version__", "of unknown version")
    print(f"{found}, torch {torch.__version__}, CUDA {torch.version.cuda}, gsplat {version}")
    truth = street(options.gaussians, degree=1)
    scene = StreetScene(truth, {}, SkyMap.constant(torch.tensor([0.6, 0.7, 0.9])))
    K = view(width, height)[0]
    camera = PinholeCamera(width, height, *(float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))))

    def peak() -> str:
        return f"peak memory {torch.cuda.max_memory_allocated() / 2**20:.0f} MiB"

    there, here = draw(scene, camera, options.repeats, device)
    cameras = f"{len(HEADINGS)} x {width}x{height}"
    print(
        f"rendering {len(truth)} Gaussians, {cameras}: {1 / there:.1f} frames/s on the device, "
        f"{1 / here:.1f} as uint8 on the CPU, {peak()}",
        flush=True,
    )
    for kind in ("forward", "step"):
        times = over_gsplat(truth, options.size, options.repeats, device)
        direct, ours = times[f"direct {kind}"] * 1e3, times[f"rasterize {kind}"] * 1e3
        print(
            f"{kind}, one camera: gsplat directly {direct:.2f} ms, rasterize {ours:.2f} ms, "
            f"{ours - direct:+.2f} ms or {100 * (ours / direct - 1):+.0f} %",
            flush=True,
        )
    views, depths = recordings(scene, camera, options.places, device)
    start = Initialisation(
        background=worse(truth),
        actors={},
        sky=SkyMap.constant(torch.full((3,), 0.5)),
        sky_pixels=[np.zeros(0, np.int64) for _ in views],
        depths=depths,
    )
    trained = train(views, start, options.steps, device)
    print(
        f"training on {len(views)} views {width}x{height}: {trained['steps']:.1f} steps/s, "
        f"{len(start.background)} to {trained['gaussians']:.0f} Gaussians, "
        f"{trained['first']:.1f} to {trained['last']:.1f} dB in {options.steps} steps, {peak()}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure; 2 where there is no GPU or no gsplat, after one line that says so."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--gaussians", type=int, default=300_000)
    parser.add_argument("--size", type=int, nargs=2, default=(960, 640))
    parser.add_argument("--places", type=int, default=16, help="of the three cameras, for training")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--device", default="cuda")
    options = parser.parse_args(arguments)
    try:
        device = pick_device(options.device)
        load_gsplat()
    except InputError as error:
        print(f"benchmarks/cuda.py: {error}", file=sys.stderr)
        return 2
    measure(options, device)
    return 0


if __name__ == "__main__":
    sys.exit(main())
