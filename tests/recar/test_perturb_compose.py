from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.cli.recar_sets import Perturb
from recast.core.errors import InputError
from recast.core.files import write_json
from recast.recar import read_real_crops
from recast.recar.perturb import (
    PerturbationConfig,
    perturb,
    read_perturbations,
    surroundings,
    write_perturbations,
)
from recast.recar.perturb_kind import find_object
from recast.trellis import check_crop

from .perturb_cars import drawn_car

CAR = drawn_car(48)
NAMES = [kind.name for kind in PerturbationConfig().kinds()]
ALL_PERTURBED = PerturbationConfig(rho_clean=0.0)


def test_clean_with_probability_rho() -> None:
    config = PerturbationConfig(
        rho_clean=0.3, **{name.replace("-", "_"): {"weight": 0} for name in NAMES[4:]}
    )
    rng = np.random.default_rng(0)
    drawn = [perturb(CAR, config, rng) for _ in range(400)]
    clean = [one for one in drawn if not one.applied]
    assert len(clean) / len(drawn) == pytest.approx(0.3, abs=0.06)
    assert all(one.rgba is CAR for one in clean)
    assert {name for one in drawn for name, _ in one.applied} == set(NAMES[:4])


def test_results_pass_the_check_and_follow_the_configuration() -> None:
    rng = np.random.default_rng(1)
    order = {name: place for place, name in enumerate(NAMES)}
    counts, seen = set(), set()
    for _ in range(150):
        one = perturb(CAR, ALL_PERTURBED, rng)
        check_crop(one.rgba, "result")
        places = [order[name] for name, _ in one.applied]
        assert places == sorted(set(places))
        assert all(0.1 <= severity <= 1 for _, severity in one.applied)
        counts.add(len(places))
        seen |= {name for name, _ in one.applied}
    assert counts == {1, 2, 3}
    assert seen == set(NAMES)


def test_equal_seeds_give_equal_pictures() -> None:
    for seed in range(10):
        one, other = (perturb(CAR, ALL_PERTURBED, np.random.default_rng(seed)) for _ in range(2))
        assert np.array_equal(one.rgba, other.rgba) and one.applied == other.applied


def test_draws_that_hide_too_much_are_drawn_again() -> None:
    """Cropping by half or more at each draw: only the milder ones can be left."""
    config = PerturbationConfig(
        rho_clean=0.0,
        composed=(1, 1),
        least_visible=0.75,
        **{name.replace("-", "_"): {"weight": 0} for name in NAMES if name != "cropping"},
    )
    rng = np.random.default_rng(0)
    whole = np.count_nonzero(CAR[..., 3] > 204)
    for _ in range(60):
        left = perturb(CAR, config, rng).rgba
        assert np.count_nonzero(left[..., 3] > 204) >= 0.75 * whole
    never = config.model_copy(
        update={"cropping": config.cropping.model_copy(update={"severity": (1.0, 1.0)})}
    )
    assert perturb(CAR, never, rng).applied == ()


def test_large_pictures_are_cut_and_brought_down() -> None:
    large = np.pad(drawn_car(600), ((300, 50), (0, 200), (0, 0)))
    near = surroundings(large, 448)
    assert find_object(near).extent == pytest.approx(448, abs=2)
    assert near.shape[1] <= 1.52 * 448
    kept = surroundings(large, 2000)
    box, whole = find_object(kept), find_object(large)
    assert (box.width, box.height) == (whole.width, whole.height)


def test_a_picture_without_an_object_is_refused() -> None:
    with pytest.raises(InputError, match="zero everywhere"):
        perturb(np.zeros((20, 20, 4), np.uint8), PerturbationConfig(), np.random.default_rng(0))


def test_groups_of_the_paper_are_equally_likely() -> None:
    weights = {kind.name: kind.weight for kind in PerturbationConfig().kinds()}
    groups = [
        ("motion-blur", "defocus"),
        ("other-vehicle", "pole", "border"),
        ("erosion", "dilation", "holes", "leak", "jagged"),
    ]
    for group in groups:
        assert sum(weights.pop(name) for name in group) == pytest.approx(1)
    assert len(weights) == 5 and set(weights.values()) == {1.0}


def test_configuration_round_trip(tmp_path: Path) -> None:
    config = PerturbationConfig(rho_clean=0.5, fog={"visibility_m": 60, "weight": 2})
    write_perturbations(tmp_path / "c.json", config)
    assert read_perturbations(tmp_path / "c.json") == config


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"version": 2}, "version"),
        ({"format": "other"}, "format"),
        ({"rho_clean": 1.2}, "rho_clean"),
        ({"fog": {"severity": [0.8, 0.2]}}, "fog.severity"),
        ({"pole": {"weight": -1}}, "pole.weight"),
        ({"hail": {}}, "hail"),
        ({"composed": [0, 2]}, "composed"),
        ({name.replace("-", "_"): {"weight": 0} for name in NAMES}, "record"),
    ],
)
def test_bad_configurations_are_refused(
    tmp_path: Path, change: dict[str, object], field: str
) -> None:
    path = tmp_path / "c.json"
    write_json(path, {"format": "recast-perturbations", "version": 1, **change})
    with pytest.raises(InputError) as caught:
        read_perturbations(path)
    assert caught.value.field == field


def test_command_writes_sheet_and_configuration(tmp_path: Path) -> None:
    Image.fromarray(drawn_car(48)).save(tmp_path / "car.png")
    config = tmp_path / "all.json"
    Perturb(tmp_path / "car.png", tmp_path / "sheet.png", write_config=config)()
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert min(sheet.size) > 900
        assert np.asarray(sheet.convert("L")).std() > 20
    assert read_perturbations(config) == PerturbationConfig()


@pytest.mark.real_data
def test_real_crops_survive(shared: Path) -> None:
    rng = np.random.default_rng(0)
    for vehicle in read_real_crops(shared / "data" / "vehicles"):
        rgba = vehicle.inputs[0].rgba()
        for _ in range(6):
            check_crop(perturb(rgba, ALL_PERTURBED, rng).rgba, vehicle.id)
