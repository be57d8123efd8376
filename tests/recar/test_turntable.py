"""The camera of a turntable, measured from outlines."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from recast.cli.main import main
from recast.core.errors import InputError
from recast.recar import IdentityRecord, SetRecord, begin_set, finish_set, read_set, write_identity
from recast.recar.turntable import fit_turntable
from support.vehicle_outlines import HEIGHT, SIZE, WIDTH, turntable_alphas

AZIMUTHS = np.arange(24) * 15.0


@pytest.mark.parametrize(
    ("fov", "elevation", "distance", "turn"),
    [(40, 12, 9, (0, 0)), (28, 5, 13, (1.0, -1.5)), (60, 20, 6.5, (-2, 3))],
)
def test_a_known_camera_is_measured(
    fov: float, elevation: float, distance: float, turn: tuple[float, float]
) -> None:
    fit = fit_turntable(turntable_alphas(AZIMUTHS, fov, elevation, distance, turn), AZIMUTHS, "car")
    assert fit.fov_deg == pytest.approx(fov, rel=0.03)
    assert fit.elevation_deg == pytest.approx(elevation, abs=0.5)
    assert fit.distance * SIZE[0] == pytest.approx(distance, rel=0.03)
    assert fit.size * SIZE[0] == pytest.approx(SIZE, abs=0.12)
    focal = WIDTH / 2 / np.tan(np.radians(fov) / 2)
    centre = np.array([WIDTH, HEIGHT]) / 2 - focal * np.tan(np.radians(turn)) * [-1, 1]
    assert np.abs(fit.centres - centre).max() < 2.0
    assert fit.residual_px < 0.3


def test_views_at_the_edge_are_left_out() -> None:
    alphas = turntable_alphas(AZIMUTHS)
    alphas[3] = np.roll(alphas[3], WIDTH // 3, axis=1)
    alphas[3][:, -1] |= alphas[3][:, -2]
    alphas[3][70:80, -30:] = 255
    fit = fit_turntable(alphas, AZIMUTHS, "car")
    assert fit.views == 23 and fit.fov_deg == pytest.approx(40, rel=0.03)


def test_a_camera_below_the_middle_of_the_vehicle_is_measured() -> None:
    fit = fit_turntable(turntable_alphas(AZIMUTHS, elevation_deg=-2.0), AZIMUTHS, "car")
    assert fit.elevation_deg == pytest.approx(-2, abs=1)


def test_what_is_refused() -> None:
    alphas = turntable_alphas(AZIMUTHS)
    with pytest.raises(InputError, match="1 of 1 show the whole vehicle"):
        fit_turntable(alphas[:1], AZIMUTHS[:1], "car")
    with pytest.raises(InputError, match="0 of 24 show the whole vehicle"):
        fit_turntable([np.full((HEIGHT, WIDTH), 255, np.uint8)] * 24, AZIMUTHS, "car")
    with pytest.raises(InputError, match="as wide as long"):
        fit_turntable([alphas[4]] * 24, AZIMUTHS, "car")
    with pytest.raises(InputError, match="not those of a turntable"):
        fit_turntable([alphas[7 * view % 24] for view in range(24)], AZIMUTHS, "car")
    with pytest.raises(InputError, match=r"the other way around better.*--clockwise"):
        fit_turntable([alphas[0], *alphas[:0:-1]], AZIMUTHS, "car")


def test_a_set_is_written_with_its_camera(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = SetRecord(
        complete=True,
        name="spin",
        licence="CC0-1.0",
        source="test",
        identities=2,
        azimuths_deg=tuple(AZIMUTHS[::2]),
        elevation_deg=None,
        fov_deg=None,
        width=WIDTH,
        height=HEIGHT,
        split_seed=0,
        held_out_share=0.0,
        generator=None,
    )
    views = [
        np.repeat(a[..., None], 4, axis=-1)
        for a in turntable_alphas(AZIMUTHS[::2], turn_deg=(0, 1))
    ]
    begin_set(tmp_path / "set", record, ["a", "b"])
    for name, size in (("a", SIZE), ("b", None)):
        identity = IdentityRecord(
            id=name,
            kind="sedan",
            category="car",
            colour=None,
            size=size,
            distance_m=None,
            split="train",
        )
        write_identity(tmp_path / "set", record, identity, views)
    finish_set(tmp_path / "set", record)
    out = tmp_path / "out"
    main(["recar", "camera", str(tmp_path / "set"), "--out", str(out), "--json"])
    first, second = json.loads(capsys.readouterr().out)
    assert first["distance_m"] == pytest.approx(9, rel=0.03) and second["distance_m"] is None
    assert abs(first["centre_y_px"]) > 4
    measured = read_set(out)
    assert measured.record.fov_deg == pytest.approx(40, rel=0.03)
    assert measured.identities["a"].record.distance_m == pytest.approx(9, rel=0.03)
    again = [measured.identities["a"].view(view)[..., 3] for view in range(12)]
    fit = fit_turntable(again, AZIMUTHS[::2], "car")
    assert np.abs(fit.centres - [WIDTH / 2, HEIGHT / 2]).max() < 1.5
