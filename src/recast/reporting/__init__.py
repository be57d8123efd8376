"""Reports of runs: films, bird's-eye views, plots, tables, one self-contained page."""

from recast.reporting.birdseye import BirdseyeStyle, draw_frames, draw_still
from recast.reporting.compare import ComparedRun, write_comparison
from recast.reporting.inputs import (
    NOT_MADE,
    ActorPart,
    Comparison,
    Fact,
    ImageScore,
    NotMade,
    ObservationPart,
    Picture,
    ProvenancePart,
    RegistrationPart,
    ReportInputs,
    RolloutPart,
    ScenarioPart,
    ScenePart,
    ShowcasePart,
    TruthPart,
)
from recast.reporting.report import truth_parts, write_report
from recast.reporting.video import VideoWriter, read_video, side_by_side, write_video

__all__ = [
    "NOT_MADE",
    "ActorPart",
    "BirdseyeStyle",
    "ComparedRun",
    "Comparison",
    "Fact",
    "ImageScore",
    "NotMade",
    "ObservationPart",
    "Picture",
    "ProvenancePart",
    "RegistrationPart",
    "ReportInputs",
    "RolloutPart",
    "ScenarioPart",
    "ScenePart",
    "ShowcasePart",
    "TruthPart",
    "VideoWriter",
    "draw_frames",
    "draw_still",
    "read_video",
    "side_by_side",
    "truth_parts",
    "write_comparison",
    "write_report",
    "write_video",
]
