"""Grounding DINO and SAM, tiny and with random weights, before a photograph without a log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.actors.cutout import GrabCutRemover, GroundedSamRemover, remover_of
from recast.actors.grounded_segmenter import DetectionRule
from recast.core.errors import InputError
from support.tiny_networks import write_tiny_networks
from support.vehicle_photographs import car_before_a_wall


def test_networks_cut_out_a_photograph(tmp_path: Path) -> None:
    folder = write_tiny_networks(tmp_path)
    image, _ = car_before_a_wall()
    doubtful = GroundedSamRemover(folder, DetectionRule(score=1.0), "cpu").remove(image, "van")
    assert "no van was detected in the middle" in doubtful.doubts[0]
    assert doubtful.alpha.shape == image.shape[:2] and doubtful.alpha.any()
    sure = GroundedSamRemover(folder, DetectionRule(score=0.0), "cpu").remove(image, "car")
    assert sure.alpha.dtype == np.uint8
    assert isinstance(remover_of(str(folder)), GroundedSamRemover)
    assert isinstance(remover_of("grabcut"), GrabCutRemover)
    with pytest.raises(InputError, match="folder: is missing"):
        remover_of(str(tmp_path / "none"))
