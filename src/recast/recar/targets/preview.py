"""Contact sheets: the pictures of a vehicle above the turntable of its target."""

from __future__ import annotations

import cv2
import numpy as np

from recast.recar.picture import Image
from recast.recar.targets.heading import turned
from recast.recar.targets.quality import Candidate
from recast.recar.targets.render import of_picture, render, resized
from recast.recar.targets.views import Viewpoint
from recast.splats import Gaussians

TILE = 192
"""Pixels a side of a tile."""

_GREY = 0.55  # behind the vehicles, so that black ones are seen too
_COLUMNS = (0, 2, 1, 3)  # front, left, rear, right: the way around the vehicle
_CAPTIONS = ("front", "left", "rear", "right")


def contact_sheet(candidate: Candidate) -> bytes:
    """PNG of 4 x 3 tiles: the four pictures, the target from there, and 45 degrees further on.

    The columns go around the vehicle: front, left, rear, right. A target whose heading is not
    `candidate.heading_deg` shows another side under each picture, such as its tail under the front.
    """
    rows: list[list[Image]] = [[], [], []]
    for column, index in enumerate(_COLUMNS):
        view = turned(candidate.viewpoints[index], candidate.heading_deg)
        shown = resized(of_picture(candidate.pictures[index]), TILE).before(_GREY)
        rows[0].append(_captioned(shown, f"picture: {_CAPTIONS[column]}"))
        rows[1].append(_captioned(_tile(candidate.gaussians, view), "target"))
        rows[2].append(_tile(candidate.gaussians, turned(view, 45.0)))
    sheet = np.vstack([np.hstack(row) for row in rows])
    written, data = cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))
    assert written
    return data.tobytes()


def _tile(gaussians: Gaussians, viewpoint: Viewpoint) -> Image:
    # Not framed: floaters and a target of the wrong size must be seen.
    return render(gaussians, viewpoint, TILE).before(_GREY)


def _captioned(tile: Image, text: str) -> Image:
    tile = np.ascontiguousarray(tile)
    cv2.putText(tile, text, (5, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1, cv2.LINE_AA)
    return tile
