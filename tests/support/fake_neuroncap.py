"""A planner behind NeuroNCAP's interface that checks every byte it is sent, and its rule."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from recast.core.web_server import WebServer, json_body

NAMES = (
    "CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT",
)  # fmt: skip
AUX = dict.fromkeys(
    ("objects_in_bev", "object_classes", "object_scores", "object_ids", "future_trajs")
)


def rule(speed: float, front: np.ndarray) -> list[list[float]]:
    """Points every half second: a little faster the more red there is, and to the left."""
    red = float(front[..., 0].mean()) / 255
    times = 0.5 * np.arange(1, 7)
    along, left = (speed * times * (0.8 + 0.4 * red)).tolist(), (0.2 * red * times**2).tolist()
    return [[x, y] for x, y in zip(along, left, strict=True)]


class FakePlanner:
    """What it was asked, in order, and what it answers; `answer` may be changed by a test."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.bodies: list[dict[str, Any]] = []
        self.ready = False
        self.answer: Callable[[Mapping[str, Any]], Response] = self.drive
        self.app = Starlette(
            routes=[
                Route("/alive", self.alive),
                Route("/reset", self.reset, methods=["POST"]),
                Route("/infer", self.infer, methods=["POST"]),
            ]
        )

    async def alive(self, request: Request) -> Response:
        self.asked.append("alive")
        return JSONResponse(True)

    async def reset(self, request: Request) -> Response:
        assert await json_body(request, 10) == {}
        self.asked.append("reset")
        self.ready = True
        return JSONResponse(True)

    async def infer(self, request: Request) -> Response:
        self.asked.append("infer")
        body = await json_body(request, 1 << 26)
        try:
            assert self.ready, "infer before reset"
            require_body(body)
        except (AssertionError, KeyError, ValueError) as error:
            return Response(f"{type(error).__name__} {error}", 500)
        self.bodies.append(body)
        return self.answer(body)

    def drive(self, body: Mapping[str, Any]) -> Response:
        """By the rule."""
        points = rule(body["canbus"][13], image_of(body["images"]["CAM_FRONT"]))
        return JSONResponse({"trajectory": points, "aux_outputs": AUX})


def image_of(text: str) -> np.ndarray:
    """The image of a field of `images`; nothing but a tensor is unpickled."""
    data = base64.b64decode(text, validate=True)
    tensor = torch.load(io.BytesIO(data), weights_only=True)
    assert tensor.dtype == torch.uint8 and tensor.ndim == 3 and tensor.shape[2] == 3
    assert len(data) < tensor.numel() + 4096  # the image alone, not what it was cut from
    return tensor.numpy()


def require_body(body: dict[str, Any]) -> None:
    """Raise AssertionError unless a body is one of NeuroNCAP's."""
    keys = ["images", "ego2world", "canbus", "timestamp", "command", "calibration"]
    assert list(body) == keys, list(body)
    images, calibration = body["images"], body["calibration"]
    names = list(images)
    assert names == [name for name in NAMES if name in names] and "CAM_FRONT" in names, names
    assert list(calibration) == ["camera2image", "camera2ego", "lidar2ego"]
    for name, text in images.items():
        image_of(text)
        require_array(calibration["camera2image"][name], (3, 3))
        require_rigid(calibration["camera2ego"][name])
    assert list(calibration["camera2image"]) == list(calibration["camera2ego"]) == names
    require_rigid(calibration["lidar2ego"])
    require_rigid(body["ego2world"])
    require_array(body["canbus"], (16,))
    assert abs(np.linalg.norm(body["canbus"][3:7]) - 1) < 1e-12
    assert type(body["timestamp"]) is int and body["command"] in (0, 1, 2)


def require_array(value: Any, shape: tuple[int, ...]) -> None:
    found = np.array(value)
    assert found.shape == shape and found.dtype == np.float64 and np.isfinite(found).all()


def require_rigid(value: Any) -> None:
    require_array(value, (4, 4))
    pose = np.array(value)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
    assert pose[3].tolist() == [0, 0, 0, 1]


@contextmanager
def planning() -> Iterator[tuple[FakePlanner, str]]:
    """A fake planner and its address."""
    fake = FakePlanner()
    with WebServer(fake.app, "127.0.0.1", 0).in_background() as server:
        yield fake, f"127.0.0.1:{server.port}"
