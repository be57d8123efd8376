"""One small complete report for all tests, made once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.actors.actor import NOTHING, Coverage
from recast.metrics import rollout_metrics
from recast.metrics.trust import RolloutTrust
from recast.reporting import (
    ActorPart,
    Comparison,
    Fact,
    ImageScore,
    ObservationPart,
    ProvenancePart,
    RegistrationPart,
    ReportInputs,
    RolloutPart,
    ScenarioPart,
    ScenePart,
    write_report,
    write_video,
)
from recast.scene.street_scene import ViewGaps
from recast.simulation.rollout import RolloutFailure
from recast.simulation.scene_renderer import ImageCoverage, RolloutCoverage, RolloutGaps
from reporting.made_up_actor import CANDIDATES
from reporting.made_up_rollouts import HOSTILE, STEPS, cut_in, straight_map

GAPS = RolloutGaps(ViewGaps(0.01, 0.0), ViewGaps(0.03, 0.01), 2.5)
COVERAGE = RolloutCoverage(
    (
        ImageCoverage(f"front{HOSTILE}", 0, True, Coverage(90.0, 0.5, 0.25, 0.25)),
        ImageCoverage("side", 0, False, Coverage(200.0, 0.0, 0.0, 1.0)),
        ImageCoverage(f"front{HOSTILE}", 5, True, NOTHING),
    )
)


def noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(3).integers(0, 255, shape, dtype=np.uint8)


@pytest.fixture(scope="session")
def complete(tmp_path_factory: pytest.TempPathFactory) -> ReportInputs:
    """Every part, with hostile names wherever a name comes from outside."""
    folder = tmp_path_factory.mktemp("run")
    hd_map = straight_map()
    films = {}
    for arm in ("native", "recast"):
        films[arm] = folder / f"{arm}.mp4"
        write_video(films[arm], [noise(48, 96, 3)] * 3)
    driven = {
        "native": cut_in("native", steps=STEPS),
        "recast": cut_in("recast", steps=STEPS, brake=1.5, cut=False),
    }
    parts = tuple(
        RolloutPart(
            arm,
            rollout,
            rollout_metrics(rollout, hd_map),
            {f"front{HOSTILE}": films[arm]},
            COVERAGE if arm == "recast" else None,
            RolloutTrust(0.72, f"As 7 of 10 like it {HOSTILE}", {5: "contact"}, None, True)
            if arm == "recast"
            else None,
            GAPS if arm == "recast" else None,
        )
        for arm, rollout in driven.items()
    )
    failure = RolloutFailure("s", "native", "0", "stationary", "a", "idm", "ValueError", HOSTILE)
    return ReportInputs(
        title=f"Track 0 {HOSTILE}",
        log=f"log {HOSTILE}",
        arms={"native": "Native", "recast": f"Replaced {HOSTILE}"},
        facts=(Fact(f"Planner {HOSTILE}", f"idm {HOSTILE}", f"help {HOSTILE}"),),
        actor=ActorPart(
            name=f"track 0 {HOSTILE}",
            generator=f"template {HOSTILE}",
            observation=ObservationPart(
                noise(20, 30, 4), noise(40, 60, 3), (Fact("Score", "0.81", "largest"),)
            ),
            turntable=films["native"],
            registration=RegistrationPart(
                0.31,
                0.182,
                0.15,
                1834,
                1.03,
                0.02,
                np.array([0.04, -0.02, 0.03]),
                np.array([1.02, 0.94]),
                {"front": 0.02, "rear": 0.98},
                (Fact("Front", "heading"),),
            ),
            log_path=np.stack([np.linspace(10, 60, 50), np.full(50, 3.4)], axis=1),
            source="from two views",
            all_around=noise(30, 50, 3),
            candidates=CANDIDATES,
            refinement=(f"refined {HOSTILE}", "left out 3"),
        ),
        scenarios=(
            ScenarioPart(f"Cut-in {HOSTILE}", f"Changes lane. {HOSTILE}", parts),
            ScenarioPart("Stationary", "Stands.", (RolloutPart("native", failure),)),
        ),
        scene=ScenePart(
            (ImageScore("whole image", 21.93, 18, 0.771),),
            (Comparison("frame 3", {"recorded": noise(20, 30, 3), HOSTILE: noise(20, 30, 3)}),),
            (Fact("Gaussians", "241830"),),
            (Fact("Median error", "0.061 m", HOSTILE),),
        ),
        hd_map=hd_map,
        config={"scene": {"steps": 3000}, "name": f"</pre>{HOSTILE}"},
        provenance=ProvenancePart({"torch": "2.13.0"}, {"scene": 7}, {"log": "9c1f0a7e"}),
        timings={"scene training": 312.4, "observe": 0.0},
        warnings=(f"The map was derived. {HOSTILE}",),
    )


@pytest.fixture(scope="session")
def report(complete: ReportInputs, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the complete report."""
    return write_report(complete, tmp_path_factory.mktemp("out") / "report").parent
