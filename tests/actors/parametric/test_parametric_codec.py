from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import pytest

from recast.actors.parametric import DesignCodec, ParametricVehicle, VehicleLook
from recast.actors.template.design import STYLES
from recast.core.errors import InputError

LOOK = VehicleLook(0.5, 0.1, 0.2, -1.0, 0.3, 0.8, 0.4, 0.5, 0.6)


@dataclass(frozen=True)
class Lid:
    height: Annotated[float, (0.0, 2.0)]
    open: bool


@dataclass(frozen=True)
class Pot:
    kind: Literal["iron", "clay"]
    lid: Lid
    weight: float


@pytest.mark.parametrize("style", STYLES)
def test_a_design_comes_back(style: str) -> None:
    codec = DesignCodec()
    vehicle = ParametricVehicle(style, STYLES[style], LOOK)
    numbers, choices = codec.encode(vehicle)
    assert len(numbers) == len(codec.numbers)
    assert codec.decode(numbers, choices) == vehicle
    other = replace(vehicle, look=replace(LOOK, rims=0.9))
    assert codec.decode(*codec.encode(other)) == other


def test_fields_follow_the_annotations() -> None:
    codec = DesignCodec(Pot)
    assert [one.path for one in codec.numbers] == ["lid.height", "weight"]
    assert [(one.path, one.choices) for one in codec.choices] == [
        ("kind", ("iron", "clay")),
        ("lid.open", (False, True)),
    ]
    numbers, choices = codec.encode(Pot("clay", Lid(1.5, True), 3.0))
    np.testing.assert_array_equal(numbers, [1.5, 3.0])
    np.testing.assert_array_equal(choices, [1, 1])
    # out of its range, a number is clipped; without a range it is not
    assert codec.decode(np.array([7.0, -7.0]), [0, 0]) == Pot("iron", Lid(2.0, False), -7.0)


def test_what_cannot_be_coded_is_refused() -> None:
    @dataclass(frozen=True)
    class Named:
        name: str

    with pytest.raises(TypeError, match="name"):
        DesignCodec(Named)


def test_other_fields_are_refused_by_name() -> None:
    codec = DesignCodec(Pot)
    codec.check(codec.record, "weights")
    glass = codec.record.replace("clay", "glass")
    with pytest.raises(InputError, match=r"kind.*iron, glass.*train it again"):
        codec.check(glass, "weights")
    shorter = json.dumps(json.loads(codec.record)[:-1])
    with pytest.raises(InputError, match=r"lid\.open.*only in this version"):
        codec.check(shorter, "weights")
