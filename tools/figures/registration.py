"""Draws the picture of docs/registration.md: python tools/figures/registration.py LOG TRACK.

A vehicle of `recast-mini` in the cube of the generator, in the box of the track, and after ICP,
with the LiDAR points of the track. The points are moved first, as if the labelled box were off.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image

from recast.actors import BoxLidarSegmenter, make_generator, observe, register
from recast.logs import read_log

PICTURE = Path(__file__).parents[2] / "docs" / "images" / "registration.png"
BODY, HITS, BOX = "#9aa5b1", "#c0392b", "#333333"
LABEL_YAW, LABEL_SHIFT = np.radians(6.0), (0.25, -0.15, 0.0)
"""Error of the label that the picture imitates: radians, metres."""
Array = NDArray[np.float64]


def panel(ax: Axes, title: str, body: Array, hits: Array, size: Array, views: tuple[int, int]):
    """Gaussians, LiDAR points and box along two of the axes."""
    ax.scatter(*body[::3, views].T, s=0.8, color=BODY, linewidths=0, rasterized=True)
    ax.scatter(*hits[:, views].T, s=1.5, color=HITS, linewidths=0, rasterized=True)
    half = size[list(views)] / 2
    ax.add_patch(Rectangle(-half, *(2 * half), facecolor="none", edgecolor=BOX, lw=1))
    ax.set_title(title, fontsize=9, loc="left")
    ax.set(aspect="equal", xticks=[], yticks=[])
    ax.spines[:].set_visible(False)


def main(source: str, track_id: str) -> None:
    """Make, register and draw one vehicle."""
    log = read_log(source)
    track = log.tracks[track_id]
    seen = observe(log, track_id, segmenter=BoxLidarSegmenter())
    c, s = np.cos(LABEL_YAW), np.sin(LABEL_YAW)
    moved = seen.points[::12] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + LABEL_SHIFT
    seen = replace(seen, points=moved.astype(seen.points.dtype))
    asset = make_generator("recast-mini").generate(seen, seed=0)
    actor = register(asset, seen, log, track)
    report = actor.provenance.registration
    print(report.explain())
    made = np.asarray(asset.gaussians.means.detach())
    after = np.asarray(actor.gaussians.means.detach())
    c, s = np.cos(report.icp_yaw), np.sin(report.icp_yaw)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    before = (after - report.icp_translation) / report.icp_scale @ turn
    size, cube = np.asarray(track.size), np.ones(3)
    nothing = np.zeros((0, 3))
    figure, axes = plt.subplots(2, 3, figsize=(10, 4.2), layout="constrained")
    for row, views, side in ((axes[0], (0, 2), "side"), (axes[1], (0, 1), "top")):
        panel(row[0], f"1. generated, {side}", made, nothing, cube, views)
        panel(row[1], f"2. placed in the box, {side}", before, seen.points, size, views)
        panel(row[2], f"3. after ICP, {side}", after, seen.points, size, views)
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=90, metadata={"Software": None})
    Image.open(PICTURE).quantize(32).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
