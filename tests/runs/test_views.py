"""The number of views that an actor is made from: options, records, and what is never looked at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.actors import BoxLidarSegmenter, TemplateGenerator, load_actor
from recast.core.errors import InputError
from recast.reconstruction import SceneConfig
from recast.runs.actor import ActorMakers, make_actor
from recast.runs.config import RunConfig, resolve_config
from support import made_up_actors as made_up


def resolve(views: int | None) -> RunConfig:
    return resolve_config("0", (), None, None, {"views": views}, {})


def test_one_view_is_the_default_and_the_record_says_so() -> None:
    assert resolve(None).resolved()["views"] == 1
    assert resolve(4).resolved()["views"] == 4


@pytest.mark.parametrize("views", [0, -1, 25])
def test_an_impossible_number_is_one_line(views: int) -> None:
    with pytest.raises(InputError, match="views"):
        resolve(views)


def test_an_actor_of_several_views_names_them(tmp_path: Path) -> None:
    log = made_up.street_log(made_up.car(), made_up.turning_poses())
    makers = ActorMakers(TemplateGenerator(spacing=0.2, style="estate"), BoxLidarSegmenter())
    config = SceneConfig(holdout_every=2, holdout_offset=0)
    make_actor(log, "7", makers, 0, tmp_path, config, views=3)
    record = load_actor(tmp_path / "actor").provenance
    assert {record.frame, *(one.frame for one in record.further)} == {1, 3}
    for one in record.further:
        assert one.camera == "front"
        assert one.timestamp_us == one.frame * made_up.STEP_US
        turn = np.angle(np.exp(1j * (one.azimuth - record.azimuth)))
        assert np.degrees(abs(turn)) == pytest.approx(80.0)  # two frames, 40 degrees a frame
    written = {path.name for path in (tmp_path / "observation").iterdir()}
    assert written == {"crop.png", "frame.png", "crop_2.png", "frame_2.png", "explanation.txt"} | {
        "evidence.safetensors"
    }
