"""What the comparison with the oracle found, and its file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from recast.actors.coverage import Coverage
from recast.evaluation.oracle_scores import Agreement, Rectangle
from recast.evaluation.oracle_summary import AngleBin
from recast.records import Record, read_record

VERSION: Literal[2] = 2
"""1 called the sides native and replaced."""
RECORD_FILE = "oracle_views.json"


@dataclass(frozen=True)
class OracleView:
    """One view, drawn with both actors and by the oracle.

    Attributes:
        index: from 0; names its picture.
        camera, frame, timestamp_us: the logged frame whose camera pose is used.
        distance: metres along the road from the camera to the vehicle's box centre.
        heading: radians against the road's: 0 drives ahead of the ego, pi faces it.
        azimuth, elevation: degrees, of the camera seen from the vehicle; azimuth 0 is ahead of it.
        angle: degrees to the nearest logged view.
        rectangle: left, top, right, bottom of the box in the image, whole pixels.
        baseline, candidate: scores.
        coverage: how much of the candidate was seen by the log, mirrored or invented; None for an
            actor without shares.
    """

    index: int
    camera: str
    frame: int
    timestamp_us: int
    distance: float
    heading: float
    azimuth: float
    elevation: float
    angle: float
    rectangle: Rectangle
    baseline: Agreement
    candidate: Agreement
    coverage: Coverage | None = None

    @property
    def picture(self) -> str:
        """Name of the file with baseline, candidate and truth side by side."""
        return f"view_{self.index:03d}.png"


@dataclass(frozen=True)
class OracleViews:
    """All views of one vehicle, and what they say.

    Attributes:
        track_id: the vehicle.
        logged: how many logged images show it.
        views: in the order they were drawn.
        summary: see `recast.evaluation.oracle_summary.EDGES`.
        showcase: index of the view that was kept as whole images: the one furthest from any logged
            view, at the nearest distance.
    """

    track_id: str
    logged: int
    views: tuple[OracleView, ...]
    summary: tuple[AngleBin, ...]
    showcase: int

    @property
    def beyond_60(self) -> AngleBin:
        """Views at least 60 degrees from any logged one."""
        return next(b for b in self.summary if (b.low, b.high) == (60.0, 180.0))

    def to_json(self) -> dict[str, Any]:
        """Plain data with a version; the same scenes give the same bytes."""
        return {"format": "recast-oracle-views", "version": VERSION, **asdict(self)}


class _Record(Record):
    format: Literal["recast-oracle-views"]
    version: Literal[2]
    track_id: str
    logged: int
    views: tuple[OracleView, ...]
    summary: tuple[AngleBin, ...]
    showcase: int


def read_oracle_views(folder: str | Path) -> OracleViews:
    """Read what `evaluate_oracle_views` wrote.

    Raises:
        InputError: `oracle_views.json` is missing, broken, or of another version.
    """
    path = Path(folder) / RECORD_FILE
    record = read_record(path, _Record, VERSION, "make the comparison again", "recast-oracle-views")
    return OracleViews(
        record.track_id, record.logged, record.views, record.summary, record.showcase
    )
