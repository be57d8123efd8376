"""Vehicles: sizes, closed parts, symmetry, materials, and what tells the kinds apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.synthetic.surface import MATERIAL_INDEX
from recast.synthetic.vehicles import (
    COLOURS,
    KINDS,
    build_vehicle,
    colour_shares,
    sample_colour,
    sample_kind,
    sample_parameters,
    sample_vehicle,
    vehicle_parts,
)
from recast.synthetic.vehicles.parameters import KIND_SHARES

trimesh = pytest.importorskip("trimesh")


@pytest.fixture(scope="module", params=KINDS)
def built(request):
    parameters = sample_parameters(request.param, np.random.default_rng(4))
    return parameters, vehicle_parts(parameters, "blue"), build_vehicle(parameters, "blue")


def test_every_part_is_closed_and_faces_outwards(built):
    _, parts, _ = built
    for name, part in parts:
        mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
        assert mesh.is_watertight, name
        assert mesh.is_winding_consistent, name
        assert mesh.volume > 0, name


def test_box_is_exact_and_the_tyres_stand_on_its_floor(built):
    parameters, parts, model = built
    stated = np.array([parameters.length, parameters.width, parameters.height])
    np.testing.assert_allclose(model.size, stated)
    counted = [part.vertices for name, part in parts if not name.startswith("mirror")]
    points = np.concatenate(counted)
    np.testing.assert_allclose(points.max(axis=0), stated / 2, atol=1e-9)
    np.testing.assert_allclose(points.min(axis=0), -stated / 2, atol=1e-9)
    for name, part in parts:
        if name.startswith("wheel"):
            assert part.vertices[:, 2].min() == pytest.approx(-stated[2] / 2, abs=0.004), name
            assert np.abs(part.vertices[:, 1]).max() < stated[1] / 2, name


def test_mirrors_stand_out_of_the_box(built):
    _, parts, model = built
    mirrors = [part for name, part in parts if name.startswith("mirror")]
    assert len(mirrors) >= 2
    assert max(part.vertices[:, 1].max() for part in mirrors) > model.size[1] / 2


def test_left_and_right_are_mirror_images(built):
    parameters, _, model = built
    if parameters.kind == "bus":
        pytest.skip("a bus has its doors on the right")
    areas, sides = _area_and_centre(model.surface)
    assert (areas * sides[:, 1]).sum() == pytest.approx(0, abs=1e-6 * areas.sum())
    for material in np.unique(model.surface.materials):
        chosen = model.surface.materials == material
        left = areas[chosen & (sides[:, 1] > 0)].sum()
        right = areas[chosen & (sides[:, 1] < 0)].sum()
        assert left == pytest.approx(right, rel=0.02, abs=1e-3), material


def test_surface_is_valid_and_of_a_sensible_size(built):
    _, _, model = built
    model.surface.validate()
    assert 5_000 <= len(model.surface) <= 25_000
    lengths = np.linalg.norm(model.surface.normals, axis=2)
    np.testing.assert_allclose(lengths, 1, atol=1e-3)


def test_shading_normals_agree_with_the_faces(built):
    _, _, model = built
    surface = model.surface
    corners = surface.vertices[surface.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    agree = np.einsum("fi,fi->f", cross, surface.normals.mean(axis=1))
    area = np.linalg.norm(cross, axis=1)
    assert area[agree < 0].sum() < 0.005 * area.sum()


def test_lamps_glass_tyres_and_plates_are_where_they_belong(built):
    _, _, model = built
    areas, centres = _area_and_centre(model.surface)

    def where(name: str) -> np.ndarray:
        chosen = model.surface.materials == MATERIAL_INDEX[name]
        assert areas[chosen].sum() > 0.005, name
        return centres[chosen] / (model.size / 2)

    assert where("headlamp")[:, 0].min() > 0.6
    plates = where("plate")[:, 0]
    assert plates.max() > 0.85
    assert plates.min() < -0.85
    assert where("rubber")[:, 2].max() < 0
    assert where("glass")[:, 2].mean() > 0.0
    assert where("paint")[:, 2].max() > 0.3


def test_front_differs_from_rear(built):
    _, _, model = built
    areas, centres = _area_and_centre(model.surface)
    tail = model.surface.materials == MATERIAL_INDEX["taillamp"]
    red = tail & (model.surface.colours[:, 1] < 0.05)
    assert areas[red & (centres[:, 0] < 0)].sum() > 0.02
    assert not np.any(red & (centres[:, 0] > 0))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("length", -1.0),
        ("length", float("nan")),
        ("width", 9.0),
        ("height", 0.2),
        ("wheel_radius", 0.0),
        ("wheelbase", 9.0),
        ("front_overhang", 0.1),
        ("ground_clearance", 0.9),
        ("tyre_width", 0.9),
        ("nose_height", 0.1),
        ("cowl_height", 3.0),
        ("deck_height", 0.1),
        ("belt_height", 2.0),
        ("deck_length", 3.0),
        ("windscreen_rake", 1.5),
        ("spokes", 0),
        ("rim_share", 1.2),
        ("kind", "hovercraft"),
    ],
)
def test_impossible_sizes_are_one_line_that_names_the_field(field, value):
    parameters = sample_parameters("sedan", np.random.default_rng(0))
    with pytest.raises(InputError) as error:
        build_vehicle(replace(parameters, **{field: value}), "white")
    assert error.value.field == field
    assert "\n" not in str(error.value)


def test_unknown_names_list_the_known_ones():
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="hatchback"):
        sample_parameters("tank", rng)
    with pytest.raises(InputError, match="silver"):
        build_vehicle(sample_parameters("sedan", rng), "plaid")


@pytest.mark.parametrize("kind", KINDS)
def test_samples_are_possible_and_differ(kind):
    rng = np.random.default_rng(7)
    samples = [sample_parameters(kind, rng) for _ in range(200)]
    for sample in samples:
        sample.validate()
    assert np.std([sample.length for sample in samples]) > 0.015 * samples[0].length
    assert len({sample.spokes for sample in samples}) > 3


def test_same_generator_same_vehicle():
    a, b = (sample_vehicle(np.random.default_rng(11)) for _ in range(2))
    other = sample_vehicle(np.random.default_rng(12), a.kind)
    assert (a.kind, a.colour) == (b.kind, b.colour)
    assert a.surface.vertices.tobytes() == b.surface.vertices.tobytes()
    assert a.surface.normals.tobytes() == b.surface.normals.tobytes()
    assert a.surface.vertices.tobytes() != other.surface.vertices.tobytes()


def test_shares_add_up():
    assert sum(colour.share for colour in COLOURS.values()) == pytest.approx(1)
    assert sum(KIND_SHARES.values()) == pytest.approx(1)
    for kind in KINDS:
        assert sum(colour_shares(kind).values()) == pytest.approx(1)


@pytest.mark.parametrize("kind", ["sedan", "van", "bus"])
def test_colours_are_met_as_often_as_on_the_road(kind):
    rng = np.random.default_rng(3)
    count = 4000
    drawn = [sample_colour(kind, rng) for _ in range(count)]
    expected = colour_shares(kind)
    chi_square = sum(
        (drawn.count(name) - share * count) ** 2 / (share * count)
        for name, share in expected.items()
    )
    # 99.9 % of chi-square with 10 degrees of freedom is 29.6.
    assert chi_square < 29.6
    assert set(drawn) <= set(expected)


def test_all_kinds_are_met():
    rng = np.random.default_rng(3)
    drawn = [sample_kind(rng) for _ in range(3000)]
    for kind in KINDS:
        assert drawn.count(kind) / 3000 == pytest.approx(KIND_SHARES[kind], abs=0.03)


def test_kinds_are_told_apart_by_their_outline():
    """The nearest of one outline of each kind names another vehicle's kind most of the time."""
    outlines = {
        kind: np.stack(
            [
                _outline(
                    build_vehicle(sample_parameters(kind, np.random.default_rng([s])), "white")
                )
                for s in range(2)
            ]
        )
        for kind in KINDS
    }
    means = {kind: lines[0] for kind, lines in outlines.items()}
    hits = 0
    for kind, lines in outlines.items():
        nearest = min(means, key=lambda other: float(np.abs(means[other] - lines[1]).mean()))
        hits += nearest == kind
    assert hits >= 7


def _outline(model) -> np.ndarray:
    """Height over the ground at 24 shares of the length, length and width: metres."""
    x = model.surface.vertices[:, 0] / model.size[0] + 0.5
    height = model.surface.vertices[:, 2] + model.size[2] / 2
    cells = np.clip((x * 24).astype(int), 0, 23)
    top = np.array([height[cells == cell].max() for cell in range(24)])
    return np.concatenate([top, 0.3 * np.tile(model.size[:1], 6)])


def _area_and_centre(surface) -> tuple[np.ndarray, np.ndarray]:
    corners = surface.vertices[surface.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.linalg.norm(cross, axis=1) / 2, corners.mean(axis=1)
