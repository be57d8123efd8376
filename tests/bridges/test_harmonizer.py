"""Harmonizer's HTTP interface: the body of a request, and answers that are none."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from recast.core.errors import InputError, UnreachableError
from recast.core.web_server import WebServer, json_body
from recast_bridges import harmonizer as module
from recast_bridges.harmonizer import HarmonizerRestorer, harmonizer_restorer

RNG = np.random.default_rng(0)
IMAGES = {
    "front": RNG.integers(0, 256, (32, 48, 3), np.uint8),
    "rück": RNG.integers(0, 256, (5, 7, 3), np.uint8),
}


def png(image: np.ndarray) -> str:
    data = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1]
    return base64.b64encode(data.tobytes()).decode()


def output(name: Any, image: np.ndarray) -> dict[str, Any]:
    height, width = image.shape[:2]
    shown = {"data": png(image), "mime_type": "image/png", "width": width, "height": height}
    return {"id": name, "image": shown}


def negatives() -> list[dict[str, Any]]:
    return [output(name, 255 - image) for name, image in IMAGES.items()]


class Fake:
    """Answers with the negatives of the images, or as a test says."""

    def __init__(self) -> None:
        self.answer: Callable[[], Response] = lambda: JSONResponse({"outputs": negatives()})
        self.app = Starlette(routes=[Route("/v1/infer", self.infer, methods=["POST"])])

    async def infer(self, request: Request) -> Response:
        body = await json_body(request, 1 << 20)
        wanted = {
            "images": [{"id": name, "data": png(image)} for name, image in IMAGES.items()],
            "parameters": {"output_format": "png", "context_length": 0, "return_policy": "all"},
        }
        if body != wanted:
            return JSONResponse({"error": {"message": f"not the body: {list(body)}"}}, 400)
        return self.answer()


@pytest.fixture
def served() -> Iterator[tuple[Fake, HarmonizerRestorer]]:
    fake = Fake()
    with WebServer(fake.app, "127.0.0.1", 0).in_background() as server:
        yield fake, harmonizer_restorer(f"127.0.0.1:{server.port}")


def test_images_come_back_by_their_names(served: tuple[Fake, HarmonizerRestorer]) -> None:
    fake, restorer = served
    assert restorer.name.startswith("harmonizer:127.0.0.1:")
    for change in (dict, lambda one: {**one, "id": None}):
        outputs = [change(one) for one in negatives()]
        fake.answer = lambda outputs=outputs: JSONResponse({"outputs": outputs})
        found = restorer.restore(IMAGES)
        assert list(found) == list(IMAGES)
        for name, image in IMAGES.items():
            np.testing.assert_array_equal(found[name], 255 - image)


FIRST, SECOND = negatives()
LARGE = output("front", np.zeros((64, 48, 3), np.uint8))


@pytest.mark.parametrize(
    ("outputs", "problem"),
    [
        (None, "answered no list of outputs for 2 images"),
        ([], "answered 0 outputs for 2 images"),
        ([FIRST], "answered 1 outputs for 2 images"),
        ([SECOND, FIRST], "in place of front"),
        ([FIRST, {"id": "rück"}], "its output for rück has no image with base64 data"),
        ([FIRST, None], "its output for rück has no image"),
        ([FIRST, {"image": {"data": "***"}}], "its output for rück has no image"),
        ([LARGE, SECOND], "image size: is 48x64, but the image that was sent says 48x32"),
        ([{"image": {"data": "AAAA"}}, SECOND], "image: cannot be decoded"),
    ],
)
def test_what_is_no_answer_is_one_line(
    served: tuple[Fake, HarmonizerRestorer], outputs: Any, problem: str
) -> None:
    fake, restorer = served
    fake.answer = lambda: JSONResponse({"outputs": outputs})
    with pytest.raises(InputError) as error:
        restorer.restore(IMAGES)
    line = str(error.value)
    assert line.startswith(f"restorer {restorer.name}") and problem in line and "\n" not in line


def test_errors_and_limits(
    served: tuple[Fake, HarmonizerRestorer], monkeypatch: pytest.MonkeyPatch
) -> None:
    fake, restorer = served
    with pytest.raises(InputError, match=r"answered 400 .*not the body: \['images', 'param"):
        restorer.restore({"front": IMAGES["front"]})
    monkeypatch.setattr(module, "_SPARE", 0)
    fake.answer = lambda: JSONResponse({"outputs": negatives(), "more": "a" * 20_000})
    with pytest.raises(InputError, match=r"/v1/infer: its answer has more than \d+ bytes"):
        restorer.restore(IMAGES)
    monkeypatch.setattr(module, "SECONDS", 1e-9)
    with pytest.raises(InputError, match="has not answered within 1e-09 s"):
        restorer.restore(IMAGES)


def test_nobody_there() -> None:
    with WebServer(Fake().app, "127.0.0.1", 0) as server:
        port = server.port
    with pytest.raises(
        UnreachableError, match="/v1/infer: no program listens there; start that prog"
    ):
        harmonizer_restorer(f"127.0.0.1:{port}").restore(IMAGES)
