from __future__ import annotations

import re

import numpy as np
import pytest

from recast.reporting import drawing, plots
from recast.reporting.plots import Figure, series, ticks
from reporting.made_up_rollouts import cut_in


def curves() -> list[plots.Curves]:
    return [
        plots.Curves("Native", drawing.arm_colour(0), series(cut_in(steps=30)), np.full(6, 4.0)),
        plots.Curves("Replaced", drawing.arm_colour(1), series(cut_in(steps=20)), None),
    ]


@pytest.mark.parametrize(
    ("low", "high", "most", "expected"),
    [
        (0.0, 4.5, 5, [0, 1, 2, 3, 4]),
        (-4.85, 3.2, 5, [-4, -2, 0, 2]),
        (0.0, 16.0, 8, [0, 2, 4, 6, 8, 10, 12, 14, 16]),
        (0.0, 0.3, 5, [0, 0.1, 0.2, 0.3]),
    ],
)
def test_axes_have_round_numbers(low: float, high: float, most: int, expected: list) -> None:
    assert ticks(low, high, most) == expected


def test_points_are_drawn_where_the_axes_say() -> None:
    figure = Figure(10.0, 0.0, 5.0, "gap [m]")
    figure.line([0.0, 5.0, 10.0], [0.0, 2.5, 50.0], "#123456", 2.0)
    plot = figure.plot("t", "a")
    [points] = re.findall(r'polyline points="([^"]*)"', plot.svg)
    xy = [tuple(map(float, pair.split(","))) for pair in points.split()]
    assert [x for x, _ in xy] == pytest.approx([600 * plot.left, 323.0, 600 * plot.right])
    assert [y for _, y in xy] == [222.0, 120.0, 18.0]  # what lies beyond stays at the edge


def test_plots_name_their_axes_with_units_and_mark_plans_and_moments() -> None:
    drawn = plots.rollout_plots(curves(), [0.5, 2.0])
    labels = [re.findall(r">([^<>]*\[[^<>]*\])<", plot.svg) for plot in drawn]
    assert [found[-1] for found in labels] == [
        "time to collision [s]",
        "speed [m/s]",
        "gap [m]",
        "acceleration [m/s²]",
    ]
    assert all(found[0] == "time [s]" for found in labels)
    for plot in drawn:
        strokes = re.findall(r'x1="([\d.]+)" y1="222.0" x2="\1" y2="215.0"', plot.svg)
        assert len(strokes) == 6, "a stroke for each plan"
        assert re.findall(r'font-weight="700">(\d)<', plot.svg) == ["1", "2"]
    assert all(drawing.css(curve.colour) in drawn[1].svg for curve in curves())


def test_plots_are_the_same_twice_and_take_the_page_s_colours() -> None:
    first, second = (plots.rollout_plots(curves()) for _ in range(2))
    assert first == second
    for plot in first:
        assert plot.svg.startswith("<svg") and plot.svg.endswith("</svg>")
        assert "currentColor" in plot.svg and "font-family" not in plot.svg
        assert "http" not in plot.svg and "<style" not in plot.svg and " id=" not in plot.svg
        assert plot.time_end == 3.0
