"""A small scene in the portable layout of MTGS, and what the published renderer draws of it.

The picture is composed here from the layout's own rules, not with the importer's code.
"""

from __future__ import annotations

import math
import pickle
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recast.geometry import se3
from recast.splats import Gaussians, concatenate
from recast.splats.gaussians import C0, evaluate_harmonics
from support import trained_scenes as made

NAME = "block-7f"
RECON_FROM_OFFSET = np.array([21.0, -9.0, 1.5])
SCENE_FROM_WORLD = se3.from_rotation_translation(np.eye(3), -RECON_FROM_OFFSET)
THERE = range(2, 9)  # frames in which the moving car is not marked as absent
TERMS = 5


def scene_from_car(frame: float) -> np.ndarray:
    return SCENE_FROM_WORLD @ made.world_from_car(frame)


def scene_from_parked() -> np.ndarray:
    return SCENE_FROM_WORLD @ made.world_from_parked(0)


def in_scene(gaussians: Gaussians) -> Gaussians:
    return made.moved(gaussians, SCENE_FROM_WORLD, False)


def sky_dome() -> Gaussians:
    """Far balls of one size, in the scene's axes; their colours are before the sigmoid."""
    generator = torch.Generator().manual_seed(9)
    away = torch.randn(400, 3, generator=generator)
    return Gaussians(
        means=200 * away / away.norm(dim=1, keepdim=True),
        quats=torch.zeros(400, 4),  # means nothing there: the balls are round
        log_scales=torch.full((400, 3), math.log(12.0)),
        logit_opacities=torch.full((400,), 2.0),
        sh=1.5 * torch.randn(400, 1, 3, generator=generator),
    )


def fourier() -> torch.Tensor:
    return 0.3 * torch.randn(80, TERMS, 3, generator=torch.Generator().manual_seed(4))


def part(kind: str, gaussians: Gaussians, **config: Any) -> dict[str, Any]:
    members = {
        "means": gaussians.means,
        "scales": gaussians.log_scales,
        "quats": 3 * gaussians.quats,
        "features_dc": gaussians.sh[:, 0].clone(),
        "features_rest": gaussians.sh[:, 1:].clone(),
        "opacities": gaussians.logit_opacities[:, None],
    }
    state = OrderedDict((f"gauss_params.{name}", value) for name, value in members.items())
    config = {"type": kind, "sh_degree": gaussians.sh_degree, "scale_dim": 3, **config}
    return OrderedDict(config=config, state_dict=state)


def moving(poses: np.ndarray, times: Any, gaussians: Gaussians, **config: Any) -> dict[str, Any]:
    own = part("RigidSubModel", gaussians, log_timestamps=times, **config)
    own["state_dict"]["instance_trans"] = torch.from_numpy(poses[:, :3, 3]).float()
    quats = se3.matrix_to_quat(poses[:, :3, :3])
    own["state_dict"]["instance_quats"] = torch.from_numpy(2 * quats).float()
    return own


def checkpoint(**changes: Any) -> dict[str, Any]:
    poses = np.stack([scene_from_car(frame) for frame in range(made.FRAMES)])
    absent = [frame for frame in range(made.FRAMES) if frame not in THERE]
    poses[absent, 2, 3] += 1010.0
    car = moving(
        poses,
        torch.from_numpy(made.TIMES),
        made.make_car(3, 3),
        fourier_features_dim=TERMS,
        fourier_features_scale=1.0,
        fourier_in_space="temporal",
    )
    car["state_dict"]["gauss_params.features_dc"] = fourier()
    parked = part("MirroredRigidSubModel", made.make_car(3, 2))
    place = scene_from_parked()
    parked["state_dict"]["instance_trans"] = torch.from_numpy(place[None, :3, 3]).float()
    quats = se3.matrix_to_quat(place[None, :3, :3])
    parked["state_dict"]["instance_quats"] = torch.from_numpy(quats).float()
    sky = part("SkyboxGaussianSplattingModel", sky_dome(), scale_dim=1)
    sky["state_dict"]["gauss_params.scales"] = sky_dome().log_scales[:, :1]
    background = part("VanillaGaussianSplattingModel", in_scene(made.make_background(3)))
    background["config"]["recon2world_translation"] = made.OFFSET + RECON_FROM_OFFSET
    content = {
        "skybox": sky,
        f"na_rigid_{made.CAR}": car,
        f"na_mirrored_{made.PARKED}": parked,
        "background": background,
        "na_deform_walker": part("DeformableSubModel", made.make_car(0, 5)),
        "na_rigid_other": moving(poses, torch.from_numpy(made.TIMES - 10**9), made.make_car(0, 6)),
    }
    return OrderedDict((k, v) for k, v in (content | changes).items() if v is not None)


def frames(shift: float = 0.0, later_us: int = 0) -> dict[str, Any]:
    infos = []
    for frame in range(made.FRAMES):
        pose = SCENE_FROM_WORLD @ made.world_from_rig(frame)
        pose[0, 3] += shift
        camera = {"sensor2ego_translation": np.zeros(3), "height": np.int64(1080), "valid": True}
        infos.append(
            {
                "timestamp": int(made.TIMES[frame]) + later_us,
                "token": f"{frame:016x}",
                "ego2global": pose,
                "cams": {"CAM_F0": camera},
                "gt_names": np.array(["vehicle", "pedestrian"]),
                "track_tokens": [made.CAR, made.PARKED],
            }
        )
    return {"2021-0": {"frame_infos": infos, "log_name": "drive"}}


def save(folder: Path, content: Any, pickled: Any = None) -> Path:
    (folder / NAME / "background").mkdir(parents=True)
    torch.save(content, folder / NAME / "background" / f"{NAME}.ckpt")
    if pickled is not None:
        (folder / NAME / "video_scene_dict.pkl").write_bytes(pickle.dumps(pickled))
    return folder / NAME


def shown(gaussians: Gaussians, constant: torch.Tensor, eye: torch.Tensor) -> Gaussians:
    """Colours as the published renderer gives them to the rasterizer, in the scene's axes."""
    if gaussians.sh_degree == 0:
        rgb = torch.sigmoid(constant)
    else:
        away = gaussians.means - eye
        sh = torch.cat([constant[:, None], gaussians.sh[:, 1:]], dim=1)
        rgb = (evaluate_harmonics(sh, away / away.norm(dim=1, keepdim=True)) + 0.5).clamp(0, 1)
    return Gaussians(
        gaussians.means,
        gaussians.quats,
        gaussians.log_scales,
        gaussians.logit_opacities,
        ((rgb - 0.5) / C0)[:, None],
    )


def published(
    frame: float, share: float, car_there: bool, more: Sequence[Gaussians] = ()
) -> np.ndarray:
    """The image (H, W, 3) that the published renderer draws: a readable reference.

    Harmonics are looked up in the scene's axes, whichever way an actor is turned.

    Args:
        more: further scenery, in the scene.
    """
    camera_from_scene = made.camera_from_world(frame) @ se3.inverse(SCENE_FROM_WORLD)
    eye = torch.from_numpy(se3.inverse(camera_from_scene)[:3, 3]).float()
    background, dome = in_scene(made.make_background(3)), sky_dome()
    dome.quats[:, 0] = 1.0
    half = made.make_car(3, 2)
    flip = torch.ones(16)
    flip[[1, 4, 5, 9, 10, 11]] = -1
    other = Gaussians(
        half.means * torch.tensor([1.0, -1, 1]),
        half.quats * torch.tensor([1.0, -1, 1, -1]),
        half.log_scales,
        half.logit_opacities,
        half.sh * flip[:, None],
    )
    parked = made.moved(concatenate([half, other]), scene_from_parked(), True)
    parts = [shown(one, one.sh[:, 0], eye) for one in (background, dome, parked, *more)]
    if car_there:
        car = made.moved(made.make_car(3, 3), scene_from_car(frame), True)
        terms = [
            math.cos(share * i * 2 * math.pi / TERMS)
            if i % 2 == 0
            else math.sin(share * (i + 1) * 2 * math.pi / TERMS)
            for i in range(TERMS)
        ]
        constant = sum(fourier()[:, i] * term for i, term in enumerate(terms))
        parts.append(shown(car, constant, eye))
    return made.rasterized(parts, camera_from_scene).rgb.numpy().clip(0, 1)


class Quaternion:
    """Stands for pyquaternion's class: only its name in the pickle tells them apart."""

    def __init__(self, wxyz: np.ndarray) -> None:
        self.q = wxyz


def save_whole(folder: Path, **camera: Any) -> Path:
    """A scene whose frames tell all that a log needs."""
    pickled = frames()
    mount = made.RIG_FROM_CAMERA
    lens = {"cam_intrinsic": made.CAMERA.matrix, "distortion": np.array([0.1, 0, 0, 0, 0])}
    own = {
        "cam_intrinsic": 2 * made.CAMERA.matrix,
        "distortion": np.zeros(5),
        "colmap_param": lens,
        "sensor2ego_rotation": Quaternion(se3.matrix_to_quat(mount[:3, :3])),
        "sensor2ego_translation": mount[:3, 3],
        "width": made.CAMERA.width,
        "height": made.CAMERA.height,
        **camera,
    }
    for info in pickled["2021-0"]["frame_infos"]:
        info["cams"] = {"CAM_F0": own}
        info["track_tokens"], info["gt_names"] = [made.PARKED, "x"], np.array(["bicycle", "sign"])
    pickled["2021-1"] = {"frame_infos": pickled["2021-0"]["frame_infos"][:3]}
    path = save(folder, checkpoint(), pickled)
    file = path / "video_scene_dict.pkl"
    # Protocol 2 writes the names of classes as lines.
    data = pickle.dumps(pickled, 2)
    named = f"{__name__}\nQuaternion\n".encode()
    file.write_bytes(data.replace(named, b"pyquaternion.quaternion\nQuaternion\n"))
    return path
