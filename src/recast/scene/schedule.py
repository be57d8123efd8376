"""How learning rates run over training: functions of the share done, u in [0, 1]."""

from __future__ import annotations

from recast.scene.config import SceneConfig

POSES_FROM = 0.1
"""Poses wait until the Gaussians have found their colours."""


def gaussian_rates(config: SceneConfig, u: float) -> dict[str, float]:
    """Learning rate of each field of the Gaussians; `sh` is that of the constant band."""
    return {
        "means": config.means_lr * 0.01**u,
        "quats": config.quats_lr,
        "log_scales": config.scales_lr * 0.2**u,
        "logit_opacities": config.opacities_lr * 0.3**u,
        "sh": config.colours_lr * 0.3**u,
    }


def sky_rate(config: SceneConfig, u: float) -> float:
    """Learning rate of the sky's cells."""
    return config.sky_lr * 0.1**u


def exposure_rate(config: SceneConfig, u: float) -> float:
    """Learning rate of the images' affine colours."""
    return config.exposure_lr * 0.1**u


def deformation_rate(config: SceneConfig, u: float) -> float:
    """Learning rate of the deformation network and of the actors' codes."""
    return config.deformation_lr * 0.01**u


def pose_factor(u: float) -> float:
    """Factor on the learning rates of poses: none at first, then falling to a twentieth."""
    return 0.0 if u < POSES_FROM else 1 - 0.95 * u


def coarse_factor(config: SceneConfig, u: float) -> int:
    """By how much width and height are divided: each factor has an equal part of the coarse run."""
    factors = config.coarse_factors
    if u >= config.coarse_fraction or not factors:
        return 1
    return factors[min(int(u / config.coarse_fraction * len(factors)), len(factors) - 1)]
