"""NVIDIA's Harmonizer, a diffusion model for rendered streets, as a restorer: its HTTP interface.

Source: the API reference of Harmonizer NIM 1.0.0. That reference does not show the members of an
image object; they are taken from the messages of its gRPC interface.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from typing import Any

from recast.arrays import Image
from recast.logs.images import decode, encode
from recast.simulation.renderer import BaseRestorer
from recast_bridges.json_service import JsonService

SECONDS = 300.0
"""Within which the images of a step must be back."""
_PREFIX = "harmonizer:"
_PATH = "/v1/infer"
_PARAMETERS = {"output_format": "png", "context_length": 0, "return_policy": "all"}
"""Each image for itself: nothing is kept from one step to the next."""
_SPARE = 1 << 20


class HarmonizerRestorer(BaseRestorer):
    """Sends the images of a step to a Harmonizer, which answers in their sizes.

    Nothing is open between two steps.

    Args:
        service: address at which the Harmonizer listens.
    """

    def __init__(self, service: JsonService) -> None:
        self._service = service
        self.name = f"{_PREFIX}{service.host}:{service.port}"

    def restore(self, images: Mapping[str, Image]) -> dict[str, Image]:
        """The harmonized images by name. Raises InputError: it is not there, answers an error or
        too late, or the answer lacks an image, or holds one that is damaged or of another size."""
        body = {
            "images": [
                {"id": name, "data": base64.b64encode(encode(one)).decode("ascii")}
                for name, one in images.items()
            ],
            "parameters": _PARAMETERS,
        }
        # PNG of noise is a little longer than its pixels; base64 makes 4 bytes of 3.
        most = 2 * sum(image.nbytes for image in images.values()) + _SPARE
        answer = self._service.ask("POST", _PATH, body, seconds=SECONDS, most_bytes=most)
        outputs = answer.get("outputs") if isinstance(answer, dict) else None
        if not isinstance(outputs, list) or len(outputs) != len(images):
            found = f"{len(outputs)} outputs" if isinstance(outputs, list) else "no list of outputs"
            raise self._service.fault(_PATH, f"answered {found} for {len(images)} images")
        pairs = zip(images.items(), outputs, strict=True)
        return {name: self._image(name, image, one) for (name, image), one in pairs}

    def _image(self, name: str, sent: Image, output: Any) -> Image:
        try:
            given = output.get("id")
            data = base64.b64decode(output["image"]["data"], validate=True)
        except (AttributeError, KeyError, TypeError, ValueError, binascii.Error):
            problem = f"its output for {name} has no image with base64 data"
            raise self._service.fault(_PATH, problem) from None
        if given not in (None, name):
            raise self._service.fault(_PATH, f"answered {str(given)[:80]!r} in place of {name}")
        height, width = sent.shape[:2]
        where = f"restorer {self.name}, {name}"
        return decode(data, "png", (width, height), where, "the image that was sent")


def harmonizer_restorer(address: str) -> HarmonizerRestorer:
    """The restorer of "HOST:PORT"; nothing is asked before the first image. Raises InputError: it
    is no address."""
    return HarmonizerRestorer(JsonService.at(address, f"restorer {_PREFIX}{address}"))
