"""Cameras of AlpaSim's messages: CameraSpec as one of recast's cameras, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from recast.cameras import CameraMount, PinholeCamera, RadialLens, RationalLens
from recast.cameras.lenses import fisheye_lens, ftheta_lens
from recast_bridges.alpasim.messages import message
from recast_bridges.alpasim.poses import pose_message
from recast_bridges.requests import AnyCamera

FTHETA_CENTRE = 0.5
"""Added to the principal point of f-theta cameras: NVIDIA counts from the centre of the first pixel
in NCore. AlpaSim's messages do not say; 0 takes them as they are."""

_MODELS = ("ftheta_param", "opencv_pinhole_param", "opencv_fisheye_param")
_GLOBAL = 5  # ShutterType


def read_camera(spec: Any, where: str, ftheta_centre: float = FTHETA_CENTRE) -> AnyCamera:
    """The camera of a message CameraSpec, at its native resolution.

    The rational model without k4 to k6 and thin prism is a `PinholeCamera`, as logs have it.

    Raises:
        ValueError: no camera model or several, a value that no camera has, or a windshield, which
            recast does not know.
    """
    named = [name for name in _MODELS if spec.HasField(name)]
    if len(named) != 1:
        raise ValueError(
            f"{where}: has {len(named)} camera models, expected one of {', '.join(_MODELS)}"
        )
    if spec.HasField("bivariate_windshield_model_param"):
        raise ValueError(f"{where}.bivariate_windshield_model_param: is not supported")
    param, size = getattr(spec, named[0]), (spec.resolution_w, spec.resolution_h)
    where = f"{where}.{named[0]}"
    try:
        if named[0] == "opencv_pinhole_param":
            camera = _pinhole(param, size)
        elif named[0] == "opencv_fisheye_param":
            focal = param.focal_length_x, param.focal_length_y
            centre = param.principal_point_x, param.principal_point_y
            camera = fisheye_lens(
                *size, *focal, *centre, tuple(param.radial_coeffs), param.max_angle
            )
        else:
            camera = _ftheta(param, size, ftheta_centre)
        camera.validate()
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    return camera


def _pinhole(param: Any, size: tuple[int, int]) -> AnyCamera:
    radial = _padded(param.radial_coeffs, 6, "radial_coeffs")
    tangential = _padded(param.tangential_coeffs, 2, "tangential_coeffs")
    prism = _padded(param.thin_prism_coeffs, 4, "thin_prism_coeffs")
    focal = param.focal_length_x, param.focal_length_y
    centre = param.principal_point_x, param.principal_point_y
    if any((*radial[3:], *prism)):
        return RationalLens(*size, *focal, *centre, radial, tangential, prism)
    k1, k2, k3, *_ = radial
    return PinholeCamera(*size, *focal, *centre, (k1, k2, *tangential, k3))


def _padded(values: Any, count: int, name: str) -> Any:
    """All coefficients; none at all stand for zeros."""
    if len(values) not in (0, count):
        raise ValueError(f"{name}: has {len(values)} coefficients, expected {count} or none")
    return tuple(values) or (0.0,) * count


def _ftheta(param: Any, size: tuple[int, int], centre: float) -> RadialLens:
    gives = {1: "angle", 2: "distance"}.get(param.reference_poly)
    if gives is None:
        raise ValueError(f"reference_poly: is {param.reference_poly}, not 1 or 2")
    own = param.pixeldist_to_angle_poly if gives == "angle" else param.angle_to_pixeldist_poly
    cde = (1.0, 0.0, 0.0)
    if param.HasField("linear_cde"):
        linear = param.linear_cde
        cde = linear.linear_c, linear.linear_d, linear.linear_e
    x, y = param.principal_point_x + centre, param.principal_point_y + centre
    return ftheta_lens(*size, x, y, tuple(own), gives, param.max_angle, cde)  # type: ignore[arg-type]


def camera_message(camera: PinholeCamera, name: str) -> Any:
    """The message CameraSpec of a pinhole camera, with its distortion and a global shutter."""
    k1, k2, p1, p2, k3 = camera.distortion
    bent = not camera.is_rectified
    param = message(
        "OpenCVPinholeCameraParam",
        principal_point_x=camera.cx,
        principal_point_y=camera.cy,
        focal_length_x=camera.fx,
        focal_length_y=camera.fy,
        radial_coeffs=[k1, k2, k3, 0.0, 0.0, 0.0] if bent else [0.0] * 6,
        tangential_coeffs=[p1, p2],
        thin_prism_coeffs=[0.0] * 4,
    )
    return message(
        "CameraSpec",
        opencv_pinhole_param=param,
        logical_id=name,
        resolution_h=camera.height,
        resolution_w=camera.width,
        shutter_type=_GLOBAL,
    )


def cameras_message(mounts: Mapping[str, CameraMount]) -> Any:
    """The message AvailableCamerasReturn of a rig. Its `rig_to_camera` is `rig_from_camera`."""
    cameras = [
        message(
            "AvailableCamera",
            intrinsics=camera_message(mount.camera, name),
            rig_to_camera=pose_message(mount.rig_from_camera),
            logical_id=name,
        )
        for name, mount in mounts.items()
    ]
    return message("AvailableCamerasReturn", available_cameras=cameras)
