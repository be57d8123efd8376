"""The cars of KITTI drive 0013, where the data is there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.actors import BoxLidarSegmenter, TemplateGenerator, observe, register
from recast.logs import DrivingLog
from recast.logs.importers.kitti import load_kitti

pytestmark = pytest.mark.real_data


@pytest.fixture(scope="module")
def drive(kitti_0013: Path) -> DrivingLog:
    labels = kitti_0013 / "tracking_labels" / "0003.txt"
    return load_kitti(kitti_0013, "2011_09_26_drive_0013", labels, ("image_02",), False, False)


@pytest.mark.parametrize(("track", "style"), [("0", "estate"), ("1", "mpv")])
def test_template_lands_on_the_lidar_points(drive: DrivingLog, track: str, style: str) -> None:
    observation = observe(drive, track, segmenter=BoxLidarSegmenter())
    assert observation.mask_quality.warnings() == ()
    asset = TemplateGenerator(spacing=0.1).generate(observation, 0)
    assert asset.details["style"] == style
    assert float(asset.details["silhouette_overlap"]) > 0.85
    report = register(asset, observation, drive, drive.tracks[track]).provenance.registration
    assert report.after.median <= 0.06
    assert report.after.median <= report.before.median
    assert report.after.inlier_share > 0.8
    assert not report.front.flipped
    assert report.icp_converged
    assert np.abs(report.icp_translation).max() < 0.2
