"""What a report shows. Every part may be missing; the page then says so and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recast.actors.actor import CandidateRecord
from recast.arrays import Array
from recast.logs.hdmap import HdMap
from recast.metrics import OracleViews, RolloutMetrics
from recast.metrics.trust import RolloutTrust
from recast.simulation.rollout import Rollout, RolloutFailure
from recast.simulation.scene_renderer import RolloutCoverage, RolloutGaps

Picture = Path | NDArray[np.uint8]
"""A PNG or JPEG file, or (H, W, 3) RGB or (H, W, 4) RGBA uint8."""
PURPOSE = (
    "The log shows this road user only from the path of the recording car. recast completes what "
    "it does not show, so the drive can be simulated again with a new motion and with the camera "
    "images that this motion would have given."
)


@dataclass(frozen=True)
class NotMade:
    """Stands where a part is missing; the page shows `reason`."""

    reason: str = "it is not part of this run"


NOT_MADE = NotMade()


@dataclass(frozen=True)
class Fact:
    """One line of a list of facts.

    Attributes:
        name, value: texts for people, with units.
        help: what it means, shown on hover, or None.
    """

    name: str
    value: str
    help: str | None = None


@dataclass(frozen=True)
class ShowcasePart:
    """The first screen: one moment that the log never had, seen in several ways.

    Attributes:
        pictures: label to picture, from left to right, the truth last.
        notes: label to the line of numbers under its picture; a label may be missing.
        best: the label whose numbers are nearest to the truth's, or None.
    """

    caption: str
    pictures: Mapping[str, Picture]
    notes: Mapping[str, str] = field(default_factory=dict)
    best: str | None = None
    numbers: str = ""
    purpose: str = PURPOSE


@dataclass(frozen=True)
class TruthPart:
    """Baseline and candidate actor against the truth, over the angle from the log.

    Attributes:
        names: "baseline", "candidate" and "truth" to their names for people.
        colours: "baseline" and "candidate" to the indices of their arms' colours.
        pictures: index of a view to its picture: baseline, candidate and truth side by side.
    """

    views: OracleViews
    names: Mapping[str, str]
    colours: Mapping[str, int]
    pictures: Mapping[int, Picture] = field(default_factory=dict)


@dataclass(frozen=True)
class ObservationPart:
    """The view of the target that the actor was made from.

    Attributes:
        crop: RGBA crop, alpha the mask.
        frame: the whole camera frame it was cut from, the box drawn in.
        facts: camera, frame, size, and the terms of the view's score.
    """

    crop: Picture | NotMade = NOT_MADE
    frame: Picture | NotMade = NOT_MADE
    facts: tuple[Fact, ...] = ()


@dataclass(frozen=True)
class RegistrationPart:
    """How well the actor fits the LiDAR points in the target's boxes.

    Attributes:
        median_before, median_after: metres from LiDAR points to the actor, before and after ICP.
        limit: metres; a larger `median_after` is flagged.
        points: LiDAR points used.
        scale: isotropic scale, found by ICP on top of the box scaling.
        yaw: yaw in radians, found by ICP on top of the coarse search.
        translation: (3,) translation, metres, actor-local frame.
        size_misfit: (2,) asset's width and height over the box's, after scaling by length, or None.
        sides: share of LiDAR points by side ("front", "rear", "left", "right"), 0..1.
        facts: anything else, such as the evidence for front against back.
    """

    median_before: float
    median_after: float
    limit: float
    points: int
    scale: float
    yaw: float
    translation: Array
    size_misfit: Array | None = None
    sides: Mapping[str, float] = field(default_factory=dict)
    facts: tuple[Fact, ...] = ()


@dataclass(frozen=True)
class ActorPart:
    """The vehicle that was made.

    Attributes:
        name: name of the target, for example "track 0 (car)".
        log_path: (N, 2) where it drove in the log, world metres, or None.
        all_around: views of the actor and of its shares; see `draw_all_around`.
        candidates: vehicles that it was chosen from.
        refinement: what following all images of the log did, in sentences.
    """

    name: str
    generator: str
    observation: ObservationPart | NotMade = NOT_MADE
    turntable: Path | NotMade = NOT_MADE
    registration: RegistrationPart | NotMade = NOT_MADE
    log_path: Array | None = None
    source: str = "from one view in the log"
    all_around: Picture | NotMade = NOT_MADE
    candidates: tuple[CandidateRecord, ...] = ()
    refinement: tuple[str, ...] = ()


@dataclass(frozen=True)
class RolloutPart:
    """One rollout of one arm.

    Attributes:
        arm: a key of `ReportInputs.arms`.
        rollout: its states, the failure that ended it, or why there is none.
        films: camera name to film of what the planner saw, one frame a step.
        coverage: what of the actor its cameras showed; None for an actor without shares.
        trust: how far to trust its verdict; None for the truth, or if it is not known.
        gaps: what its images showed that the log does not; None for the truth, or if it is not
            known.
    """

    arm: str
    rollout: Rollout | RolloutFailure | NotMade
    metrics: RolloutMetrics | NotMade = NOT_MADE
    films: Mapping[str, Path] | NotMade = NOT_MADE
    coverage: RolloutCoverage | None = None
    trust: RolloutTrust | None = None
    gaps: RolloutGaps | None = None


@dataclass(frozen=True)
class ScenarioPart:
    """The same motion of the actor under each arm.

    Attributes:
        title: title of the scenario, for example "Cut-in, setting A".
        rollouts: one rollout for each arm, in the order of `ReportInputs.arms`.
    """

    title: str
    description: str
    rollouts: tuple[RolloutPart, ...]


@dataclass(frozen=True)
class ImageScore:
    """One line of the held-out evaluation.

    Attributes:
        region: what was compared, for example "whole image" or "inside moving cars' boxes".
        psnr: PSNR, dB.
        ssim: SSIM, -1..1, or None.
    """

    region: str
    psnr: float
    frames: int
    ssim: float | None = None


@dataclass(frozen=True)
class Comparison:
    """Pictures to look at side by side.

    Attributes:
        caption: caption of the pictures, for example "frame 43, 24.1 dB".
        pictures: label to picture, such as "recorded", "rendered"; or one picture that holds both.
    """

    caption: str
    pictures: Mapping[str, Picture]


@dataclass(frozen=True)
class ScenePart:
    """How well the reconstructed scene shows images it was not trained on.

    Attributes:
        facts: number of Gaussians, training time, image size and the like.
        depth: facts on the scene's depth against the LiDAR.
    """

    scores: tuple[ImageScore, ...]
    comparisons: tuple[Comparison, ...] = ()
    facts: tuple[Fact, ...] = ()
    depth: tuple[Fact, ...] = ()


@dataclass(frozen=True)
class ProvenancePart:
    """What is needed to make the run again."""

    versions: Mapping[str, str] = field(default_factory=dict)
    seeds: Mapping[str, int] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ReportInputs:
    """Everything on the page.

    Attributes:
        arms: arm to its name for people, in the order of the columns, the baseline first.
        truth_arm: the one of `arms` that shows what is really there, or None.
        showcase: the first screen; without one the page begins with the overview.
        truth: views beyond the log against the truth; left out of the page where nothing is given.
        recording: folders of plan agreements, see `recast.metrics.plan_agreement.write_agreement`;
            one for each planner that looks at images.
        actor, scenarios, scene, hd_map, config, provenance: see their types.
        timings: step to seconds.
        warnings: what the reader has to know before trusting the page.
        replay: a page of its own with the moving scene, which is copied and linked; or None.
        camera_headings: headings in radians by name of camera, 0 ahead, positive to the left; for
            the choice of the images of a moment. Empty takes the first camera.
    """

    title: str
    log: str
    arms: Mapping[str, str]
    facts: tuple[Fact, ...] = ()
    actor: ActorPart | NotMade = NOT_MADE
    scenarios: tuple[ScenarioPart, ...] | NotMade = NOT_MADE
    scene: ScenePart | NotMade = NOT_MADE
    hd_map: HdMap | NotMade = NOT_MADE
    config: Mapping[str, Any] | NotMade = NOT_MADE
    provenance: ProvenancePart | NotMade = NOT_MADE
    timings: Mapping[str, float] | NotMade = NOT_MADE
    warnings: tuple[str, ...] = ()
    truth_arm: str | None = None
    showcase: ShowcasePart | NotMade = NOT_MADE
    truth: TruthPart | NotMade = NOT_MADE
    recording: tuple[Path, ...] = ()
    replay: Path | NotMade | None = None
    camera_headings: Mapping[str, float] = field(default_factory=dict)

    def validate(self) -> None:
        """Raise ValueError naming the field at fault."""
        if self.truth_arm is not None and self.truth_arm not in self.arms:
            raise ValueError(f"truth_arm: {self.truth_arm!r} is not in arms")
        if isinstance(self.scenarios, NotMade):
            return
        for scenario in self.scenarios:
            for i, part in enumerate(scenario.rollouts):
                where = f"scenarios[{scenario.title!r}].rollouts[{i}]"
                if part.arm not in self.arms:
                    raise ValueError(f"{where}.arm: {part.arm!r} is not in arms")
            arms = [part.arm for part in scenario.rollouts]
            if len(set(arms)) != len(arms):
                raise ValueError(f"scenarios[{scenario.title!r}].rollouts: an arm occurs twice")
