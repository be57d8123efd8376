"""Make the figures of README.md again, from a finished demo and a run on KITTI 0013.

    python benchmarks/readme.py runs/demo/run [--kitti runs/kitti/track0] [--write]

Each block between `<!-- NAME -->` and `<!-- /NAME -->` is made from its run. Without --write, the
blocks are compared: words must be the same, and numbers within 5 % or one step of the last decimal;
other processors round otherwise, and training carries that on. Exit code 1 names what differs.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from typing import Any

from recast.core.files import read_json, write_text
from recast.reporting.finding import RunFinding

README = Path(__file__).parent.parent / "README.md"
TOLERANCE = 0.05
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


def demo_block(run: Path) -> str:
    """What the demo found, and the vehicle against the truth beyond 60 degrees."""
    found = RunFinding.read(run / "report")
    assert found is not None, f"{run} has no finding"
    bins = read_json(run / "metrics.json")["truth"]["replaced"]["summary"]
    near, beyond = (
        next(one for one in bins if (one["low"], one["high"]) == edges)
        for edges in ((0.0, 30.0), (60.0, 180.0))
    )
    rows = [
        "| against the truth | reconstructed car | replaced car |",
        "|---|---|---|",
        *(
            f"| {name} | {beyond['baseline'][key]:{form}} | {beyond['candidate'][key]:{form}} |"
            for name, key, form in (
                ("PSNR, dB", "psnr", ".1f"),
                ("SSIM", "ssim", ".3f"),
                ("mask IoU", "mask_iou", ".2f"),
            )
        ),
    ]
    return "\n".join(
        [
            *(f"> {sentence}" for sentence in found.sentences),
            "",
            f"Inside the car's box, in the {beyond['views']} views more than 60 degrees away from "
            "every logged view:",
            "",
            *rows,
            "",
            f"In the {near['views']} views within 30 degrees of the log's, PSNR is "
            f"{near['baseline']['psnr']:.1f} dB and {near['candidate']['psnr']:.1f} dB.",
        ]
    )


def kitti_block(run: Path) -> str:
    """Held-out images and registration of a run on a recorded drive."""
    told = read_json(run / "metrics.json")
    scene, actor = told["scenes"]["recast"], told["actors"]["replaced"]
    median = actor["registration"]["after"]["median"]
    return "\n".join(
        [
            "| measured on that drive (8 s, one camera at 621x188) | reached |",
            "|---|---|",
            "| held-out images (every 8th), whole image | "
            f"{scene['psnr']:.2f} dB PSNR, {scene['ssim']:.3f} SSIM |",
            "| held-out images, inside the boxes of moving cars | "
            f"{scene['box_psnr']:.2f} dB PSNR |",
            f"| LiDAR points to the registered vehicle, median | {median:.2f} m |",
        ]
    )


def differences(old: str, new: str) -> list[str]:
    """Where two blocks differ in words, or in numbers by more than `TOLERANCE`."""
    words = _NUMBER.sub("#", old), _NUMBER.sub("#", new)
    if words[0] != words[1]:
        return [f"words differ:\n{old}\n---\n{new}"]
    pairs = zip(_NUMBER.findall(old), _NUMBER.findall(new), strict=True)
    return [f"{a} is now {b}" for a, b in pairs if not _close(a, b)]


def _close(one: str, other: str) -> bool:
    digits = len(one.partition(".")[2])
    step = 10.0**-digits if digits else 0.0  # counts are exact
    return abs(float(one) - float(other)) <= max(TOLERANCE * float(one), 1.001 * step)


def main(arguments: list[str] | None = None, readme: Path = README) -> int:
    """Compare or write; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("demo", type=Path, help="run folder of `recast demo`")
    parser.add_argument("--kitti", type=Path, help="run folder of the README's KITTI run")
    parser.add_argument("--write", action="store_true", help="replace the blocks")
    given: Any = parser.parse_args(arguments)
    blocks = {"demo": demo_block(given.demo)}
    if given.kitti is not None:
        blocks["kitti"] = kitti_block(given.kitti)
    text, wrong = readme.read_text(), 0
    for name, new in blocks.items():
        pattern = re.compile(f"(<!-- {name} -->\n)(.*?)(\n<!-- /{name} -->)", re.DOTALL)
        found = pattern.search(text)
        assert found is not None, f"{readme}: no block {name}"
        for line in differences(found[2], new):
            print(f"{name}: {line}")
            wrong += 1
        text = text[: found.start(2)] + new + text[found.end(2) :]
    if given.write:
        write_text(readme, text)
        return 0
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
