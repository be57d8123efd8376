"""Compare arms and planners: python examples/5_grid.py OUT_FOLDER SCENE MOTION [PLANNER ...].

A SCENE is a synthetic street such as urban-straight:3, or LOG_FOLDER:TRACK.
"""

import sys

import recast


def main(out: str, scene: str, motion: str, *planners: str) -> None:
    results = recast.run_grid(
        [scene],
        out,
        arms=["native", "replaced"],  # the first is the baseline
        planners=planners or ("idm-follower", "constant-velocity"),
        motions=[motion],
        steps=40,
        samples=2000,
    )
    for row in results.rows:  # all columns: OUT_FOLDER/rollouts.parquet
        said = row.failure_reason or f"TTC {row.scores['ttc']} s"
        print(f"{row.planner} {row.arm} {row.motion}-{row.setting}: {said}")
    for one in results.differences:
        if one.metric == "ttc":
            change = one.sampled.point
            print(f"{one.planner}: {one.candidate} - {one.baseline}: {change:+.2f} s TTC")


if __name__ == "__main__":
    main(*sys.argv[1:])
