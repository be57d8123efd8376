"""Odyssey's scenes: ground sheets, a cubemap of the sky and the ego's places in the checkpoint."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.scene import load_scene, render_scene
from recast.splats import Gaussians
from recast_bridges.scenes import import_mtgs
from support import trained_scenes as made
from support.mtgs_scenes import (
    RECON_FROM_OFFSET,
    checkpoint,
    published,
)
from support.odyssey_scenes import (
    ANCHOR,
    LEAST,
    MOST,
    THICKNESS,
    calibration,
    ground,
    odyssey,
    sheets,
    surface,
)


@pytest.fixture(scope="module")
def log() -> DrivingLog:
    return made.make_log()


def drawn_sheets(follow: bool) -> Gaussians:
    """The sheets as the published renderer draws them: yaw alone, then the surface's tilt."""
    own = sheets()
    quats = own.quats.double().numpy()
    turn = Rotation.from_rotvec(
        2 * np.arctan2(quats[:, 3], quats[:, 0])[:, None] * np.array([0.0, 0, 1])
    )
    if follow:
        turn = Rotation.from_quat(surface(), scalar_first=True) * turn
    scales = own.log_scales.exp()
    scales[:, :2] = scales[:, :2].clamp(LEAST, MOST)
    scales[:, 2] = THICKNESS
    wxyz = torch.from_numpy(turn.as_quat(scalar_first=True)).float()
    return Gaussians(own.means, wxyz, scales.log(), own.logit_opacities, own.sh)


def save(folder: Path, content: Any) -> Path:
    folder.mkdir()
    torch.save(content, folder / "scene.ckpt")
    return folder


@pytest.fixture(scope="module")
def far_log(log: DrivingLog) -> DrivingLog:
    """The same drive, its world as far from the map's origin as the scene."""
    return replace(log, world_offset=ANCHOR - RECON_FROM_OFFSET)


@pytest.mark.parametrize("follow", [True, False])
@pytest.mark.parametrize("adrift", [False, True])
def test_the_ground_is_drawn_as_published(
    far_log: DrivingLog, tmp_path: Path, follow: bool, adrift: bool
) -> None:
    node = ground(follow)
    if adrift:  # an exporter takes the anchor off the ground alone
        state = node["state_dict"]
        state["gauss_params.means"] = (
            state["gauss_params.means"].double() - torch.from_numpy(ANCHOR)
        ).float()
    # The reference draws the dome of far Gaussians, too.
    content = {**odyssey(), "ground": node, "skybox": checkpoint()["skybox"]}
    record = import_mtgs(save(tmp_path / "a", content), far_log, tmp_path / "b")
    scene, frame = load_scene(tmp_path / "b"), 5
    camera = made.camera_from_world(frame)
    image = render_scene(scene, made.CAMERA, camera, {}).rgb
    without = published(frame, 0.5, False)
    expected = published(frame, 0.5, False, [drawn_sheets(follow)])
    told = [line for line in record.changed if line.startswith("ground: moved")]
    assert bool(told) == adrift
    if adrift:
        # Millions of metres in float32 are multiples of a quarter, so they are off by an eighth.
        there = sheets().means + torch.from_numpy(RECON_FROM_OFFSET).float()
        apart = (there[:, None] - scene.background.means).abs().amax(dim=2).amin(dim=1)
        assert apart.max() <= 0.125 + 1e-5
    else:
        assert np.abs(image - expected).max() < 5e-4  # as for the rest of the layout
    assert np.abs(image - without).max() > 0.1


def test_the_sky_is_looked_up_in_the_axes_of_its_training(
    far_log: DrivingLog, tmp_path: Path
) -> None:
    colours = torch.rand(6, 3, generator=torch.Generator().manual_seed(1))
    content = odyssey()
    faces = colours[:, None, None].expand(6, 32, 32, 3).contiguous()
    content["background"]["config"]["omnire_environment"] = faces
    record = import_mtgs(save(tmp_path / "a", content), far_log, tmp_path / "b")
    sky = load_scene(tmp_path / "b").sky.colours
    rows, columns = sky.shape[:2]
    # Faces are +x, -x, +y, -y, +z, -z of the direction (x, z, -y).
    looks = {(1, 0): 0, (0, 1): 5, (-1, 0): 1, (0, -1): 4}
    for (x, y), face in looks.items():
        column = int((math.atan2(y, x) / (2 * math.pi) + 0.5) * columns) % columns
        assert torch.allclose(sky[rows // 2, column], colours[face], atol=2e-5)
    assert torch.allclose(sky[0, 0], colours[2], atol=2e-5)  # the zenith
    assert torch.allclose(sky[-1, 0], colours[3], atol=2e-5)
    assert "sky cubemap, resampled" in record.changed
    assert not any(line.startswith("sky") for line in record.left_out)


def test_what_is_left_out_is_named(far_log: DrivingLog, tmp_path: Path) -> None:
    record = import_mtgs(save(tmp_path / "a", odyssey()), far_log, tmp_path / "b")
    assert set(record.tracks) == {made.CAR, made.PARKED}
    assert any(line.startswith("na_lights: a OmniReTrafficLight") for line in record.left_out)
    assert any(line.startswith("exposure") for line in record.left_out)
    assert "0.00 m from the log's (median of 11 frames)" in record.placed_by
    assert any(line.startswith("sky: the checkpoint has none") for line in record.left_out)


def test_the_saved_ego_is_compared_with_the_log(far_log: DrivingLog, tmp_path: Path) -> None:
    content = odyssey()
    content["background"]["config"]["omnire_calibration"] = calibration(aside=2.5)
    record = import_mtgs(save(tmp_path / "a", content), far_log, tmp_path / "b")
    assert record.warnings == ["the ego of the scene is 2.50 m from the log's"]
    content["background"]["config"]["omnire_calibration"] = calibration(later_us=10**9)
    with pytest.raises(InputError, match=r"scene\.ckpt: timestamp: no frame is in log drive"):
        import_mtgs(save(tmp_path / "c", content), far_log, tmp_path / "d")


def changed_ground(place: str, key: str, value: Any) -> dict[str, Any]:
    node = ground()
    if value is None:
        del node[place][key]
    else:
        node[place][key] = value
    return odyssey() | {"ground": node}


def changed_background(key: str, value: Any) -> dict[str, Any]:
    content = odyssey()
    content["background"]["config"][key] = value
    return content


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (changed_ground("config", "thickness", None), r"ground\.config\.thickness: is missing"),
        (changed_ground("config", "thickness", 0.0), "thickness: is 0 m"),
        (changed_ground("config", "min_planar_extent", 1.0), "max_planar_extent are 1, 0.4"),
        (
            changed_ground("state_dict", "surface_quats", None),
            r"ground\.state_dict\.surface_quats: is missing",
        ),
        (
            changed_ground("state_dict", "surface_quats", torch.ones(3, 4)),
            r"surface_quats: has shape \[3, 4\]",
        ),
        (
            changed_ground("config", "surface_follow", False),
            "surface_quats: is there, but config.surface_follow is not set",
        ),
        (
            changed_ground("state_dict", "gauss_params.quats", torch.tensor([[0.0, 1, 0, 0]] * 60)),
            "quats: holds a quaternion without a turn about z",
        ),
        (
            changed_ground("state_dict", "gauss_params.means", torch.full((60, 3), 1e6)),
            "recon2world_translation: does not bring the ground near the scene",
        ),
        (
            changed_background("omnire_environment", torch.ones(6, 4, 8, 3)),
            r"omnire_environment: has faces of \[4, 8\]",
        ),
        (
            changed_background("omnire_calibration", calibration() | {"ego_to_global": [1.0]}),
            r"ego_to_global: has shape \[1\], expected \[11, 4, 4\]",
        ),
        (
            changed_background("omnire_calibration", calibration(later_us=-(10**10))),
            "training_timestamps_us: are not microseconds",
        ),
    ],
)
def test_broken_scenes_are_refused_by_key(
    far_log: DrivingLog, tmp_path: Path, content: Any, line: str
) -> None:
    with pytest.raises(InputError, match=line):
        import_mtgs(save(tmp_path / "a", content), far_log, tmp_path / "scene")
    assert not (tmp_path / "scene").exists()
