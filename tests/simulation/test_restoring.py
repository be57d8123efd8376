"""Restored images: of what was rendered alone, checked, and the same for every other camera."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recast.arrays import Image
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.simulation import MOTIONS, NullRenderer, RolloutSetup, SimState, Simulator
from recast.simulation.renderer import MountedRenderer, RestoringRenderer, make_restorer
from support.tiny_served import CAMERA, MOVING, RIG_FROM_CAMERA, make_log

PLAIN = CameraMount(CAMERA, RIG_FROM_CAMERA)
SEEN = np.zeros((32, 48), np.bool_)
SEEN[4:20, 10:40] = True
MOUNTS = {
    "plain": PLAIN,
    "virtual": replace(PLAIN, seen=SEEN),
    "window": replace(PLAIN, window=(8, 2, 40, 30)),
}
STATE: SimState = Simulator(RolloutSetup(make_log(), MOVING, MOTIONS["cut-in-a"])).state


class Grey(MountedRenderer):
    """Grey where something is rendered."""

    def render(self, state: SimState, camera_names: Any) -> dict[str, Image]:
        images = {}
        for name in camera_names:
            mount = self._mounts[name]
            image = mount.masked(
                np.full((mount.camera.height, mount.camera.width, 3), 100, np.uint8)
            )
            images[name] = image if mount.seen is None else image * mount.seen[..., None]
        return images


class Brighter:
    """Adds ten to every pixel, black ones too."""

    name = "brighter"

    def __init__(self) -> None:
        self.shapes: dict[str, tuple[int, ...]] = {}

    def restore(self, images: Mapping[str, Image]) -> dict[str, Image]:
        self.shapes = {name: image.shape for name, image in images.items()}
        return {name: image + np.uint8(10) for name, image in images.items()}


def test_only_what_was_rendered_is_restored() -> None:
    plain, restorer = Grey(MOUNTS), Brighter()
    renderer = RestoringRenderer(plain, restorer)
    assert renderer.mounts == MOUNTS and renderer.restored_by == "brighter"
    found = renderer.render(STATE, list(MOUNTS))
    assert list(found) == list(MOUNTS)
    assert restorer.shapes == {
        "plain": (32, 48, 3), "virtual": (32, 48, 3), "window": (28, 32, 3)
    }  # fmt: skip
    for name, image in plain.render(STATE, list(MOUNTS)).items():
        np.testing.assert_array_equal(found[name], np.where(image > 0, 110, 0))


def test_nothing_is_asked_without_cameras() -> None:
    restorer = Brighter()
    assert RestoringRenderer(NullRenderer(MOUNTS), restorer).render(STATE, ()) == {}
    assert not restorer.shapes


class Wrong:
    name = "wrong"

    def __init__(self, answer: Any) -> None:
        self._answer = answer

    def restore(self, images: Mapping[str, Image]) -> Any:
        return self._answer(images)


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        (lambda images: {}, "plain: no image was returned"),
        (lambda images: dict.fromkeys(images), "plain: no image was returned"),
        (lambda images: {k: v[1:] for k, v in images.items()}, r"uint8 \(31, 48, 3\), not uint8"),
        (lambda images: {k: v / 255 for k, v in images.items()}, r"is float64 \(32, 48, 3\)"),
    ],
)
def test_an_answer_that_is_no_image_is_one_line(answer: Any, problem: str) -> None:
    renderer = RestoringRenderer(Grey(MOUNTS), Wrong(answer))
    with pytest.raises(InputError, match=f"restorer wrong: .*{problem}") as error:
        renderer.render(STATE, ["plain"])
    assert "\n" not in str(error.value)


def test_restorers_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_restorer.py").write_text(
        "class Same:\n    name = 'same'\n    def restore(self, images):\n        return images\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    assert make_restorer("my_restorer:Same").name == "same"
    assert make_restorer("harmonizer:localhost:8000").name == "harmonizer:localhost:8000"
    assert make_restorer(given := Brighter()).part is given  # type: ignore[attr-defined]
    del sys.modules["my_restorer"]
    for word, problem in (
        ("harmonizer:localhost", "is not an address; give HOST:PORT"),
        ("nothing", "restorer: nothing: is not known"),
        ("recast.arrays:Image", "restorer: recast.arrays:Image: "),
    ):
        with pytest.raises(InputError, match=problem):
            make_restorer(word)
