"""Draws the pictures of docs/coordinate_frames.md: python tools/figures/drawings.py."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon, Rectangle

FOLDER = Path(__file__).parents[2] / "docs" / "images" / "frames"
X, Y, Z = "#c0392b", "#1e8449", "#1f4e9c"
"""Colours of the axes x, y, z."""
INK, FAINT, BODY = "#333333", "#999999", "#e8e8e8"


def arrow(ax: Axes, start: tuple[float, float], step: tuple[float, float], colour: str, word: str):
    """One axis of a frame, with its name at the tip."""
    end = np.add(start, step)
    ax.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2})
    side = np.add(end, 0.18 * np.array(step) / np.hypot(*step))
    ax.text(*side, word, color=colour, ha="center", va="center", fontsize=10, weight="bold")


def outward(ax: Axes, place: tuple[float, float], colour: str, word: str, toward: bool = True):
    """An axis that points at the reader (a dot), or away (a cross)."""
    ax.add_patch(Circle(place, 0.11, fill=False, color=colour, lw=1.5))
    ax.plot(*place, "." if toward else "x", color=colour, ms=6 if toward else 7)
    ax.text(
        place[0] - 0.26,
        place[1] - 0.26,
        word,
        color=colour,
        ha="center",
        va="center",
        fontsize=10,
        weight="bold",
    )


def box(ax: Axes, centre: tuple[float, float], size: tuple[float, float], turn: float = 0.0):
    """A body seen from above or from the side; its windscreen end is to the right."""
    length, width = size
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (length / 2, width / 2)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    ax.add_patch(Polygon(corners @ matrix.T + centre, facecolor=BODY, edgecolor=FAINT, lw=1.2))


def note(ax: Axes, x: float, y: float, text: str, **options):
    """Words in the drawing."""
    ax.text(x, y, text, **{"color": INK, "fontsize": 9, "ha": "center", "va": "center", **options})


def blank(ax: Axes, title: str, x: tuple[float, float], y: tuple[float, float]):
    """Axes without ticks, of equal scale."""
    ax.set_title(title, fontsize=10.5, color=INK, loc="left")
    ax.set(xlim=x, ylim=y, aspect="equal", xticks=[], yticks=[])
    ax.spines[:].set_color("#dddddd")


def from_above(ax: Axes):
    """World, rig and box."""
    blank(ax, "From above: world, rig and box", (-1.2, 11.6), (-1.4, 6.0))
    arrow(ax, (0, 0), (1.3, 0), X, "x")
    arrow(ax, (0, 0), (0, 1.3), Y, "y")
    outward(ax, (0, 0), Z, "z")
    note(ax, 1.1, -0.75, "world: near the first ego pose")
    turn = np.deg2rad(20)
    forward = np.array([np.cos(turn), np.sin(turn)])
    left = np.array([-forward[1], forward[0]])
    rear = np.array([3.3, 1.5])
    box(ax, tuple(rear + 1.35 * forward), (4.4, 1.9), turn)
    arrow(ax, tuple(rear), tuple(1.3 * forward), X, "x")
    arrow(ax, tuple(rear), tuple(1.3 * left), Y, "y")
    outward(ax, tuple(rear), Z, "z")
    note(ax, 4.4, 0.35, "rig: middle of the rear axle,\non the ground", ha="left")
    other, turned = np.array([9.0, 4.0]), np.deg2rad(150)
    box(ax, tuple(other), (4.2, 1.8), turned)
    ahead = np.array([np.cos(turned), np.sin(turned)])
    arrow(ax, tuple(other), tuple(1.3 * ahead), X, "x")
    arrow(ax, tuple(other), tuple(1.3 * np.array([-ahead[1], ahead[0]])), Y, "y")
    outward(ax, tuple(other), Z, "z")
    note(ax, 8.6, 1.75, "box of an actor:\nits centre", ha="left")
    ax.plot([0, rear[0]], [0, rear[1]], "--", color=FAINT, lw=1)
    note(ax, 1.55, 1.1, "world_from_rig", color=FAINT, rotation=24)
    ax.plot([0, other[0]], [0, other[1]], ":", color=FAINT, lw=1)
    note(ax, 6.55, 3.2, "world_from_actor", color=FAINT, rotation=24)


def from_the_side(ax: Axes):
    """Rig, camera and LiDAR on the vehicle, which looks to the right of the drawing."""
    blank(ax, "From the vehicle's right: rig, camera and LiDAR", (-2.4, 8.6), (-0.9, 4.2))
    ax.axhline(0, color=FAINT, lw=1)
    box(ax, (1.35, 0.95), (4.4, 1.3))
    for x in (0.0, 2.8):
        ax.add_patch(Circle((x, 0.34), 0.34, facecolor="#bbbbbb", edgecolor=FAINT))
    arrow(ax, (0, 0), (1.1, 0), X, "x")
    arrow(ax, (0, 0), (0, 1.1), Z, "z")
    outward(ax, (0, 0), Y, "y", toward=False)
    note(ax, 1.0, -0.5, "rig")
    arrow(ax, (1.9, 1.75), (1.2, 0), Z, "z")
    arrow(ax, (1.9, 1.75), (0, -0.9), Y, "y")
    outward(ax, (1.9, 1.75), X, "x", toward=True)
    ax.add_patch(Polygon([(1.9, 1.75), (8.4, 2.95), (8.4, 0.55)], facecolor=Z, alpha=0.06))
    note(ax, 6.0, 1.55, "camera: x right (towards you),\ny down, z into the scene")
    arrow(ax, (0.5, 2.6), (1.0, 0), X, "x")
    arrow(ax, (0.5, 2.6), (0, 0.9), Z, "z")
    outward(ax, (0.5, 2.6), Y, "y", toward=False)
    note(
        ax, 4.3, 3.3, "LiDAR: its own sensor frame on disk;\npoints in memory are in the rig frame"
    )


def image_plane(ax: Axes):
    """Pixel coordinates."""
    blank(ax, "Image: pixel coordinates", (-0.9, 7.2), (5.6, -1.0))
    for column in range(6):
        for row in range(4):
            ax.add_patch(Rectangle((column, row), 1, 1, facecolor="none", edgecolor="#cccccc"))
    ax.plot(0.5, 0.5, "o", color=INK, ms=4)
    arrow(ax, (0, 0), (6.5, 0), X, "u")
    arrow(ax, (0, 0), (0, 4.5), Y, "v")
    note(
        ax,
        3.1,
        5.2,
        "centre of the first pixel: (0.5, 0.5)\nthe image covers [0, width] x [0, height]",
    )


def unit_cube(ax: Axes):
    """Generator's cube."""
    blank(ax, "Unit cube of a generator: before registration", (-1.15, 1.85), (-0.95, 1.0))
    ax.add_patch(Rectangle((-0.5, -0.5), 1, 1, facecolor="none", edgecolor=FAINT, ls="--"))
    box(ax, (0, -0.33), (0.98, 0.33))
    ax.add_patch(
        Polygon(
            [(-0.3, -0.17), (-0.18, 0.02), (0.16, 0.02), (0.3, -0.17)],
            facecolor=BODY,
            edgecolor=FAINT,
        )
    )
    arrow(ax, (0, 0), (0.42, 0), X, "x")
    arrow(ax, (0, 0), (0, 0.42), Z, "z")
    note(ax, 0, 0.78, "z is up; the heading may be any\n(recast-mini: +x is the front)", fontsize=8)
    note(ax, -0.5, -0.62, "-0.5", fontsize=8)
    note(ax, 0.5, -0.62, "0.5", fontsize=8)
    note(ax, -0.66, 0.46, "0.5", fontsize=8)
    note(ax, 1.2, 0.0, "axes, yaw,\nscale, shift", fontsize=8.5)
    ax.annotate(
        "", (1.62, -0.32), (0.62, -0.32), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.2}
    )
    note(ax, 1.2, -0.6, "box of the track\n(metres, x forward)", fontsize=8.5)


def main() -> None:
    """Write both drawings as SVG."""
    plt.rcParams.update({"svg.hashsalt": "recast", "font.family": "DejaVu Sans"})
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, panels, widths, size in (
        ("vehicles.svg", (from_above, from_the_side), (1.25, 1), (10, 3.7)),
        ("image_and_cube.svg", (image_plane, unit_cube), (1, 1.15), (9, 3.4)),
    ):
        figure, axes = plt.subplots(1, 2, figsize=size, width_ratios=widths, layout="constrained")
        for panel, ax in zip(panels, axes, strict=True):
            panel(ax)
        figure.savefig(FOLDER / name, metadata={"Date": None}, bbox_inches="tight")
        plt.close(figure)


if __name__ == "__main__":
    main()
