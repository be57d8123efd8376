from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.views import camera_names, read_view, read_views, scaled_camera


def test_kittis_half_size_and_principal_point() -> None:
    camera = scaled_camera(PinholeCamera(1242, 375, 721.5, 721.5, 610.1, 173.4), 0.5)
    assert (camera.width, camera.height) == (621, 188)
    assert camera.cx == pytest.approx(610.1 / 2) and camera.cy == pytest.approx(173.4 * 188 / 375)


def test_split_is_by_frame(tiny_log: DrivingLog) -> None:
    views = read_views(tiny_log, SceneConfig(scale=0.5))
    assert [view.frame for view in views if view.held_out] == [3, 11, 19]
    assert views[0].image.shape == (24, 80, 3)
    nothing = read_views(tiny_log, SceneConfig(scale=0.5, holdout_every=0))
    assert not any(view.held_out for view in nothing)


def test_unknown_camera(tiny_log: DrivingLog) -> None:
    with pytest.raises(InputError, match="camera front"):
        camera_names(tiny_log, SceneConfig(cameras=("front",)))
    with pytest.raises(InputError, match="the log has none"):
        camera_names(replace(tiny_log, cameras={}), SceneConfig())


class OneImage:
    def __init__(self, image: np.ndarray) -> None:
        self._image = image

    def __len__(self) -> int:
        return 24

    def __getitem__(self, index: int) -> np.ndarray:
        return self._image


def test_distorted_images_are_rectified_and_their_rim_masked(tiny_log: DrivingLog) -> None:
    stream = tiny_log.cameras["image_02"]
    camera = replace(stream.camera, distortion=(0.2, 0.0, 0.0, 0.0, 0.0))  # pincushion
    rays = camera.rays(camera.pixel_grid())  # what a raw pixel looks at
    image = np.zeros((camera.height, camera.width, 3), np.uint8)
    image[..., 0] = np.clip(128 + 100 * rays[..., 0], 0, 255)
    image[..., 1] = np.clip(128 + 200 * rays[..., 1], 0, 255)
    raw = replace(stream, camera=camera, images=OneImage(image))
    view = read_view(tiny_log, raw, 0, 1.0)
    assert view.camera.is_rectified and view.mask is not None
    straight = view.camera.rays(view.camera.pixel_grid())
    inner = np.zeros(view.mask.shape, bool)
    inner[4:-4, 4:-4] = True
    inner &= view.mask
    assert np.abs(view.image[..., 0] - (128 + 100 * straight[..., 0]))[inner].max() < 3
    assert np.abs(view.image[..., 1] - (128 + 200 * straight[..., 1]))[inner].max() < 3
    assert 0.7 < view.mask.mean() < 1.0 and not view.mask[0, 0]


def test_a_cameras_views_share_their_mask(tiny_log: DrivingLog) -> None:
    stream = tiny_log.cameras["image_02"]
    bent = replace(stream.camera, distortion=(0.2, 0.0, 0.0, 0.0, 0.0))
    log = replace(tiny_log, cameras={"image_02": replace(stream, camera=bent)})
    views = read_views(log, SceneConfig(scale=0.5))
    assert views[0].mask is not None and not views[0].mask.all()
    assert all(view.mask is views[0].mask for view in views)
