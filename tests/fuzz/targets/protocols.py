"""What others send over the network: requests of renderers' clients, the listing of a hub."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
from huggingface_hub import set_client_factory

from fuzz.target import Target
from recast.core.errors import InputError
from recast.core.files import parse_json, read_bytes, write_json
from recast.weights.fetch import list_source
from recast.weights.table import Licence, WeightsSource
from recast_bridges.alpasim.messages import camera_message, message, pose_pair
from recast_bridges.alpasim.server import SensorsimService
from recast_bridges.neuroncap.service import NcapService
from recast_bridges.rendering import ScenePainter
from recast_bridges.requests import RefusedError, RenderRequest
from support import tiny_served

_LARGEST = 1 << 26  # bytes of a message
_COMMIT = "0123456789abcdef" * 2 + "01234567"
_ENCODED = {"sha256": "a" * 64, "size": 5_000_000, "pointerSize": 134}
_LISTING = {
    "id": "someone/networks",
    "sha": _COMMIT,
    "siblings": [
        {"rfilename": "config.json", "size": 700, "blobId": "b" * 40},
        {"rfilename": "a/model.safetensors", "size": 5_000_000, "blobId": "c" * 40}
        | {"lfs": _ENCODED},
    ],
}


class _Painter(ScenePainter):
    """Notes what it is to draw, and draws one grey pixel."""

    def draw(self, request: RenderRequest, wanted: Callable[[], bool] = lambda: True) -> Any:
        self.requests.append(request)
        return np.full((1, 1, 3), 128, np.uint8)


@cache
def _painter() -> _Painter:
    return _Painter(tiny_served.served(), "cpu")


def _asked(ask: Callable[[], object]) -> list[RenderRequest]:
    """The requests that reach the painter; a refused call is an `InputError` of its status."""
    _painter().requests = []
    try:
        ask()
    except RefusedError as refused:
        raise InputError(
            "request", refused.code, refused.details, "give what can be drawn"
        ) from None
    return _painter().requests


def _write_sensorsim(folder: Path) -> None:
    """Three images in one call: of a pinhole camera with distortion, a fisheye and an f-theta."""
    size = {"resolution_h": 32, "resolution_w": 48}
    centre = {"principal_point_x": 24.0, "principal_point_y": 16.0}
    fisheye = message(
        "OpenCVFisheyeCameraParam",
        **centre,
        **{"focal_length_x": 30.0, "focal_length_y": 30.0},
        **{"radial_coeffs": [0.01, 0.0, 0.0, 0.0], "max_angle": 0.8},
    )
    ftheta = message(
        "FthetaCameraParam",
        **centre,
        **{"reference_poly": 1, "pixeldist_to_angle_poly": [0.0, 0.03], "max_angle": 0.8},
        linear_cde=message("LinearCde", linear_c=1.0),
    )
    cameras = [
        camera_message(tiny_served.BENT, "front"),
        message("CameraSpec", **size, opencv_fisheye_param=fisheye),
        message("CameraSpec", **size, ftheta_param=ftheta),
    ]
    car, rig = tiny_served.ahead(np.array([14.0, 3.0]), -1.0)
    seen = message("DynamicObject", track_id=tiny_served.MOVING, pose_pair=pose_pair(car))
    requests = [
        message(
            "RGBRenderRequest",
            scene_id=tiny_served.SCENE,
            **size,
            camera_intrinsics=camera,
            frame_start_us=7_000_000,
            frame_end_us=7_030_000,
            sensor_pose=pose_pair(rig @ tiny_served.RIG_FROM_CAMERA),
            dynamic_objects=[seen],
            image_format=kind,
            image_quality=95.0,
            ego_pose=pose_pair(rig),
        )
        for camera, kind in zip(cameras, (1, 2, 4), strict=True)
    ]
    whole = message("AggregatedRenderRequest", rgb_requests=requests)
    (folder / "request.pb").write_bytes(whole.SerializeToString())


def _read_sensorsim(path: Path) -> object:
    service = SensorsimService(_painter())
    return _asked(lambda: service.answer("render_aggregated", path.read_bytes()))


def _write_ncap(folder: Path) -> None:
    service = NcapService(_painter(), tiny_served.SCENE)
    pose = tiny_served.ahead(np.array([3.0]), 0.0)[0] @ tiny_served.RIG_FROM_CAMERA
    image = {"pose": pose.tolist(), "timestamp": 7_000_000, "image_format": "png"}
    image["camera_name"] = next(iter(tiny_served.MOUNTS))
    # Few poses, or nearly all damage would fall on them.
    actors = [
        actor | {"poses": actor["poses"][:3], "timestamps": actor["timestamps"][:3]}
        for actor in service.actors()
    ]
    write_json(folder / "requests.json", {"actors": actors, "image": image})


def _read_ncap(path: Path) -> object:
    service = NcapService(_painter(), tiny_served.SCENE)
    value = parse_json(path, read_bytes(path, _LARGEST))
    found = value if isinstance(value, dict) else {}

    def ask() -> None:
        service.update(found.get("actors"))
        service.image(found.get("image"))

    return _asked(ask), json.dumps(service.actors(), allow_nan=False)


def _read_listing(path: Path) -> object:
    licence = Licence("MIT", "https://example.org/mit")
    source = WeightsSource("someone/networks", ("*",), licence, _COMMIT)
    answer = httpx2.Response(200, content=path.read_bytes())
    set_client_factory(lambda: httpx2.Client(transport=httpx2.MockTransport(lambda _: answer)))
    return list_source(source)


TARGETS = (
    Target(
        "sensorsim-request",
        _write_sensorsim,
        lambda f, out: _read_sensorsim(f / "request.pb"),
        weight=6.0,
    ),
    Target(
        "neuroncap-request",
        _write_ncap,
        lambda f, out: _read_ncap(f / "requests.json"),
        weight=6.0,
    ),
    Target(
        "hub-listing",
        lambda f: write_json(f / "listing.json", _LISTING),
        lambda f, out: _read_listing(f / "listing.json"),
        weight=6.0,
    ),
)
