"""Find where a planner begins to fail: python examples/7_search.py OUT SCENE MOTION OVER [PLANNER].

A SCENE is a synthetic street such as urban-straight:3, or LOG_FOLDER:TRACK; OVER is a setting of
the motion with its range, such as gap=2:40.
"""

import sys

import recast
from recast.studies.boundary import sentence


def main(out: str, scene: str, motion: str, over: str, planner: str = "gtrs-mini") -> None:
    found = recast.search(
        [scene],
        out,
        motions=[motion],
        over=[over],
        planners=[planner],
        arms=["native"],
        design="bisect",
        trials=8,
        steps=60,
    )
    for one in found.lines:  # all trials: OUT/trials.parquet; the page: OUT/index.html
        print(f"{one.line.planner}: {sentence(one, found.results.settings.design.axes)}")
        for crossing in one.crossings:
            print(f"between {crossing.low:g} and {crossing.high:g}")


if __name__ == "__main__":
    main(*sys.argv[1:])
