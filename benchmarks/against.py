"""Two built trees of recast draw the same views in turns: ratios of the rasterizer's cost.

    python benchmarks/raster.py --against ../recast-before --isas avx2

Each tree runs in its own process, from its own `.venv` (`make setup` there), on Gaussians given as
tensors; only `recast.splats`' public names are used. Times are CPU milliseconds of whole calls, the
minimum over the repeats.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

WORK = ("forward", "step", "frozen")


class Tree:
    """A process that draws with the `recast` of a tree."""

    def __init__(self, python: Path, tensors: Path, threads: int) -> None:
        command = [str(python), __file__, str(tensors), str(threads)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def milliseconds(self, **request: Any) -> float:
        """CPU milliseconds of one call."""
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        print(json.dumps(request), file=stdin, flush=True)
        answer = stdout.readline()
        if not answer:
            raise SystemExit("a tree's process ended; its message stands above")
        return float(answer)

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def compare(
    folder: Path,
    gaussians: dict[str, torch.Tensor],
    sizes: tuple[tuple[int, int], ...],
    isas: list[str],
    repeats: int,
    threads: int,
) -> None:
    """Print a line a kernel, image size and work: both trees' milliseconds and their ratio.

    Args:
        folder: the other tree.
        gaussians: fields of `recast.splats.Gaussians` by name.
        sizes: width and height of the images, pixels.
    """
    python = folder / ".venv" / "bin" / "python"
    if not python.is_file():
        raise SystemExit(f"{folder}: no .venv/bin/python; run make setup there")
    with tempfile.TemporaryDirectory() as temporary:
        tensors = Path(temporary) / "gaussians.pt"
        torch.save(gaussians, tensors)
        trees = [Tree(where, tensors, threads) for where in (python, Path(sys.executable))]
        print(f"{'image':>8} {'kernel':>9} {'work':>8} {'there':>8} {'here':>8} {'ratio':>7}")
        for width, height in sizes:
            for isa in isas:
                for work in WORK:
                    least = [float("inf")] * 2
                    for _ in range(repeats):
                        for i, tree in enumerate(trees):
                            spent = tree.milliseconds(work=work, isa=isa, size=(width, height))
                            least[i] = min(least[i], spent)
                    print(
                        f"{width:>4}x{height:<3} {isa:>9} {work:>8} {least[0]:>8.1f} "
                        f"{least[1]:>8.1f} {least[1] / least[0]:>7.2f}",
                        flush=True,
                    )
        for tree in trees:
            tree.close()


def serve(tensors: str, threads: int) -> None:
    """Answer requests on standard input."""
    from recast import splats
    from recast.splats import native

    torch.set_num_threads(threads)
    native.set_threads(threads)
    gaussians = splats.Gaussians(**torch.load(tensors))
    leaves = splats.Gaussians(
        **{name: value.clone().requires_grad_() for name, value in vars(gaussians).items()}
    )
    # x right, y down, z forward: the car looks along +x.
    camera = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    here = torch.eye(4)
    # A tree that freezes nothing draws a frozen scene like any other.
    frozen = splats.freeze(gaussians) if hasattr(splats, "freeze") else None

    def forward(K: torch.Tensor, width: int, height: int) -> None:
        with torch.no_grad():
            splats.rasterize(gaussians, camera, K, width, height)

    def step(K: torch.Tensor, width: int, height: int) -> None:
        image = splats.rasterize(leaves, camera, K, width, height)
        ones = [torch.ones_like(plane) for plane in (image.rgb, image.depth, image.alpha)]
        torch.autograd.backward([image.rgb, image.depth, image.alpha], ones)
        for leaf in vars(leaves).values():
            leaf.grad = None

    def still(K: torch.Tensor, width: int, height: int) -> None:
        if frozen is None:
            forward(K, width, height)
        else:
            splats.rasterize_frozen([(frozen, here)], camera, K, width, height)

    works: dict[str, Callable[[torch.Tensor, int, int], None]] = {
        "forward": forward,
        "step": step,
        "frozen": still,
    }
    for line in sys.stdin:
        request = json.loads(line)
        width, height = request["size"]
        focal = 700 * width / 960
        K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        native.set_isa(request["isa"])
        start = time.process_time()
        works[request["work"]](K, width, height)
        print((time.process_time() - start) * 1e3, flush=True)


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]))
