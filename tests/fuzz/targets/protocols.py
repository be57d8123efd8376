"""What other programs ask and answer: requests to render, and listings of a weights hub."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fuzz.target import Target
from recast.core.errors import InputError
from recast.protocols.alpasim.cameras import camera_message
from recast.protocols.alpasim.messages import message
from recast.protocols.alpasim.poses import pose_pair
from recast.protocols.alpasim.server import SensorsimService
from recast.protocols.rendering import ScenePainter
from recast.protocols.requests import RefusedError
from recast.weights.table import Licence, Source
from recast.weights.transfer import listed_files
from support.tiny_served import CAMERA, RIG_FROM_CAMERA, SCENE, served

_SOURCE = Source("someone/toy", ("*",), Licence("MIT", "https://example.org/mit"))


@cache
def _service() -> SensorsimService:
    return SensorsimService(ScenePainter(served(), "cpu"))


def _write_request(folder: Path) -> None:
    pose = pose_pair(RIG_FROM_CAMERA)
    moved = message("DynamicObject", track_id="7", pose_pair=pose)
    asked = message(
        "RGBRenderRequest",
        scene_id=SCENE,
        resolution_h=CAMERA.height,
        resolution_w=CAMERA.width,
        camera_intrinsics=camera_message(CAMERA, "front"),
        frame_start_us=7_000_000,
        frame_end_us=7_000_000,
        sensor_pose=pose,
        image_format=4,
        image_quality=95.0,
        dynamic_objects=[moved],
    )
    (folder / "request.pb").write_bytes(asked.SerializeToString())


def _answered(folder: Path) -> Any:
    """The reply; a status is the protocol's way to refuse in one line."""
    try:
        reply = _service().answer("render_rgb", (folder / "request.pb").read_bytes())
    except RefusedError as refused:
        raise InputError("request", refused.code, refused.details, "correct it") from None
    return np.frombuffer(reply, np.uint8)


def _write_listing(folder: Path) -> None:
    files = [
        {"rfilename": "config.json", "size": 12, "blobId": "0" * 40},
        {
            "rfilename": "deep/a.safetensors",
            "size": 5000,
            "lfs": {"sha256": "1" * 64, "size": 5000},
        },
    ]
    (folder / "listing.json").write_text(json.dumps({"sha": "2" * 40, "siblings": files}))


TARGETS = (
    Target("sensorsim-request", _write_request, lambda f, out: _answered(f), weight=6.0),
    Target(
        "hub-listing",
        _write_listing,
        lambda f, out: listed_files(_SOURCE, "hub", (f / "listing.json").read_bytes()),
        weight=8.0,
    ),
)
