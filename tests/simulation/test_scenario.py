from __future__ import annotations

import pytest

from recast.errors import InputError
from recast.simulation import MOTIONS, parse_motions, scenario_name


def test_every_name_reads_back() -> None:
    assert len(MOTIONS) == 10
    for name, motion in MOTIONS.items():
        assert scenario_name(motion) == name
        assert parse_motions(name) == (motion,)


def test_without_a_letter_it_is_all_settings() -> None:
    assert parse_motions("cut-in") == (MOTIONS["cut-in-a"], MOTIONS["cut-in-b"])
    assert [m.name for m in parse_motions("Oncoming")] == ["oncoming", "oncoming"]
    assert parse_motions(" oncoming-Through ")[1] is MOTIONS["oncoming-through-b"]


@pytest.mark.parametrize("name", ["cutin", "cut-in-c", "", "stationary-"])
def test_unknown_names_list_the_known(name: str) -> None:
    with pytest.raises(InputError, match=r"cut-in-a, cut-in-b, oncoming-a.*advancing-b"):
        parse_motions(name)
