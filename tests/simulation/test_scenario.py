from __future__ import annotations

import pytest

from recast.errors import InputError
from recast.simulation import MOTIONS, parse_motion, scenario_name


def test_every_name_reads_back() -> None:
    assert len(MOTIONS) == 10
    for name, motion in MOTIONS.items():
        assert scenario_name(motion) == name
        assert parse_motion(name) is motion


def test_without_a_letter_it_is_setting_a() -> None:
    assert parse_motion("cut-in") is MOTIONS["cut-in-a"]
    assert parse_motion("Oncoming-Through") is MOTIONS["oncoming-through-a"]


@pytest.mark.parametrize("name", ["cutin", "cut-in-c", "", "stationary-"])
def test_unknown_names_list_the_known(name: str) -> None:
    with pytest.raises(InputError, match=r"cut-in-a, cut-in-b, oncoming-a.*advancing-b"):
        parse_motion(name)
