"""What holds for everything that stands beside a road."""

from collections.abc import Callable

import numpy as np
import pytest

from recast.synthetic import scenery
from recast.synthetic.surface import Surface

Builder = Callable[[np.random.Generator], Surface]

CASES: dict[str, tuple[Builder, int]] = {
    **{
        f"building-{style}-{width}": (
            lambda rng, style=style, width=width, depth=depth: scenery.building(
                rng, width, depth, style
            ),
            2000,
        )
        for style, sizes in {
            "urban": ((8, 10), (22, 15)),
            "suburban": ((8, 8), (15, 12)),
            "industrial": ((20, 20), (60, 50)),
            "office": ((18, 15), (50, 25)),
        }.items()
        for width, depth in sizes
    },
    **{
        f"tree-{style}": (lambda rng, style=style: scenery.tree(rng, 8.0, style), 3000)
        for style in scenery.TREE_STYLES
    },
    "tree-far": (lambda rng: scenery.tree(rng, 8.0, "round", 0.3), 1200),
    "bush": (lambda rng: scenery.bush(rng, 1.0), 1500),
    "hedge": (lambda rng: scenery.hedge(rng, 12.0), 1500),
    "lamp_post": (lambda rng: scenery.lamp_post(rng), 300),
    "pole_line": (lambda rng: scenery.pole_line(rng, 100.0), 1600),
    **{
        f"signal-{state}-{reach}": (
            lambda rng, state=state, reach=reach: scenery.traffic_signal(rng, state, reach),
            900,
        )
        for state in scenery.SIGNAL_STATES
        for reach in (0.0, 5.0)
    },
    **{
        f"sign-{kind}": (lambda rng, kind=kind: scenery.road_sign(rng, kind), 450)
        for kind in scenery.SIGN_KINDS
    },
    **{
        f"fence-{style}": (lambda rng, style=style: scenery.fence(rng, 10.0, style), 900)
        for style in scenery.FENCE_STYLES
    },
    "guard_rail": (lambda rng: scenery.guard_rail(rng, 20.0), 400),
    **{
        f"wall-{style}": (lambda rng, style=style: scenery.wall(rng, 20.0, 2.0, style), 200)
        for style in scenery.WALL_STYLES
    },
    "bridge": (lambda rng: scenery.bridge(rng, 18.0, 11.0, 5.0, (0.0,)), 1000),
    "hoarding": (lambda rng: scenery.hoarding(rng), 400),
    "bench": (scenery.bench, 300),
    "litter_bin": (scenery.litter_bin, 300),
    "hydrant": (scenery.hydrant, 400),
    "parking_meter": (scenery.parking_meter, 300),
    "bollard": (scenery.bollard, 200),
    "container": (lambda rng: scenery.container(rng), 800),
    "pallets": (lambda rng: scenery.pallets(rng), 1200),
}


def build(name: str, seed: int = 0) -> Surface:
    return CASES[name][0](np.random.default_rng(seed))


@pytest.mark.parametrize("name", CASES)
def test_valid_within_budget_and_standing_on_the_ground(name: str) -> None:
    for seed in range(4):
        surface = build(name, seed)
        surface.validate()
        assert 0 < len(surface) <= CASES[name][1], f"seed {seed}: {len(surface)} triangles"
        assert np.all((surface.colours >= 0) & (surface.colours <= 1))
        low, high = surface.bounds()[:, 2]
        assert -0.5 <= low <= 0.01, "stands on the ground, foundations to 0.5 m"
        assert high > 0.2


@pytest.mark.parametrize("name", CASES)
def test_no_triangle_without_area_and_normals_are_unit(name: str) -> None:
    surface = build(name, 5)
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    # Leaves may be pressed flat on the ground; all else must be seen.
    assert np.mean(area < 1e-9) < (0.02 if name in ("bush", "hedge") else 1e-12)
    lengths = np.linalg.norm(surface.normals, axis=2)[area > 1e-9]
    np.testing.assert_allclose(lengths, 1.0, atol=1e-4)


@pytest.mark.parametrize("name", CASES)
def test_same_generator_same_surface(name: str) -> None:
    first, second = build(name, 3), build(name, 3)
    for field in ("vertices", "faces", "normals", "colours", "materials"):
        assert getattr(first, field).tobytes() == getattr(second, field).tobytes(), field


@pytest.mark.parametrize("name", CASES)
def test_generators_give_variety(name: str) -> None:
    looks = {
        (surface.vertices.tobytes(), surface.colours.tobytes())
        for surface in (build(name, seed) for seed in range(8))
    }
    # Some things, such as a fence of iron, come in a few kinds only; none in one.
    assert len(looks) >= 2
    if name.startswith(("building", "tree", "bush")):
        assert len(looks) == 8
