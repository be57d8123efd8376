from __future__ import annotations

from pathlib import Path

import pytest

from recast.errors import InputError
from recast.simulation import (
    MOTIONS,
    CutIn,
    Oncoming,
    Stationary,
    motion_of_record,
    read_scenario,
    scenario_record,
)

GOOD = """\
# a comment
version: 1
name: hard-cut-in
motion: cut-in
description: >
  Cuts in
  hard.
settings:
  near:
    gap: 4  # m
    initial_speed: 0.9
    target_speed: 0.2
    delay: 0.0
    duration: 1.5
  "2":
    gap: 1e1
    initial_speed: 0.9
    target_speed: 0.2
    delay: 0.0
    duration: 1.5
"""


def read(tmp_path: Path, text: str | bytes) -> tuple[object, ...]:
    path = tmp_path / "my.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_scenario(path)


def test_a_good_file_is_read(tmp_path: Path) -> None:
    names = {"name": "hard-cut-in", "description": "Cuts in hard."}
    assert read(tmp_path, GOOD) == (
        CutIn("near", 4.0, 0.9, 0.2, 0.0, 1.5, **names),
        CutIn("2", 10.0, 0.9, 0.2, 0.0, 1.5, **names),
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("    gap: 4  # m", "    gap: -60", "my.yaml:10: gap: is -60; give -50 to 500 m"),
        ("target_speed: 0.2", "target_speed: -1",
         "my.yaml:12: target_speed: is negative; give 0 to 5 of v_r"),
        ("duration: 1.5", "duration: 0.0", "my.yaml:14: duration: is 0; give more than 0, at"),
        ("delay: 0.0", "delay: .nan", "my.yaml:13: delay: is '.nan'; give 0 to 60 s"),
        ("delay: 0.0", "delay: nan", "my.yaml:13: delay: is nan; give 0 to 60 s"),
        ("delay: 0.0", "delay: 1:30", "my.yaml:13: delay: is '1:30'; give 0 to 60 s"),
        ("delay: 0.0", 'delay: "0.5"', "my.yaml:13: delay: is '0.5'; give 0 to 60 s"),
        ("delay: 0.0", "delay: true", "my.yaml:13: delay: is true; give 0 to 60 s"),
        ("delay: 0.0", "delay:", "my.yaml:13: delay: is empty; give 0 to 60 s"),
        ("delay: 0.0", "delay: [1]", "my.yaml:13: delay: is a list; give 0 to 60 s"),
        ("    delay: 0.0\n", "", "my.yaml:9: delay: is missing; give 0 to 60 s"),
        ("delay: 0.0", "dely: 0.0", "my.yaml:13: dely: is not known; did you mean delay?"),
        ("delay: 0.0", "side: 0.0", "my.yaml:13: side: is not known; the keys are gap, initial_"),
        ("delay: 0.0", "gap: 5.0", "my.yaml:13: gap: is given twice, first in line 10; remove"),
        ("version: 1", "version: 2", "my.yaml:2: version: is the number 2, this recast reads 1"),
        ("version: 1", 'version: "1"', "my.yaml:2: version: is '1', this recast reads 1"),
        ("version: 1\n", "", "my.yaml:2: version: is missing; write version: 1"),
        ("motion: cut-in", "motion: cutin", "my.yaml:4: motion: is 'cutin'; choose one of cut-in,"),
        ("motion: cut-in", "motion: [a]", "my.yaml:4: motion: is a list; choose one of cut-in,"),
        ("name: hard-cut-in", "name: ../up", "my.yaml:3: name: is '../up'; use small letters"),
        ("name: hard-cut-in", "name: 7", "my.yaml:3: name: is the number 7; use small letters"),
        ("name: hard-cut-in\n", "", "my.yaml:2: name: is missing; give one"),
        ("  near:", "  Near by:", "my.yaml:9: setting Near by: is 'Near by'; use small letters"),
        ("description: >", "other: >", "my.yaml:5: other: is not known; the keys are version,"),
        ("motion: cut-in", "motion: cut-in: x", "my.yaml:4: YAML: cannot be read"),
        ("    delay", "\tdelay", "my.yaml:13: YAML: cannot be read"),
        ("  near:", "  ? [a]\n  : 1\n  near:", "my.yaml:9: YAML: has a key that is no word"),
        ("delay: 0.0", "delay: !!python/object/apply:os.system [ls]",
         "my.yaml:13: YAML: has the tag tag:yaml.org,2002:python/object/apply:os.system"),
        ("    delay: 0.0\n", "    <<: 1\n", "my.yaml:13: <<: is not known"),
        ("settings:\n", "settings: {}\nother:\n", "my.yaml:9: other: is not known"),
    ],
)  # fmt: skip
def test_errors_name_file_line_and_key(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as error:
        read(tmp_path, GOOD.replace(old, new, 1))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "my.yaml: YAML: is empty"),
        ("# nothing\n", "my.yaml: YAML: is empty"),
        ("- a\n", "my.yaml:1: scenario: is no list of keys"),
        ("a: 1\n---\nb: 2\n", "my.yaml:2: YAML: cannot be read (but found another document)"),
        ("version: 1\nsettings: &a\n  x: *a\n", "my.yaml:3: YAML: holds an alias of itself"),
        (b"version: 1\nname: \xff\n", "my.yaml:2: file: is not UTF-8 text"),
        ("version: 1\n\nname: \x00\n", "my.yaml:3: YAML: holds a character"),
        ("[" * 5000, "my.yaml: YAML: is nested too deeply"),
        ("version: 1\nname: x\nmotion: advancing\nsettings:\n", "my.yaml:4: settings: is empty"),
        ("version: 1\nname: x\nmotion: advancing\nsettings:\n  a: 3\n",
         "my.yaml:5: setting a: is the number 3; give gap, speed below it"),
    ],
)  # fmt: skip
def test_what_is_no_scenario(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    assert message in str(error.value)


def test_a_folder_is_no_scenario(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_scenario(tmp_path)


def test_optional_numbers_may_be_left_out(tmp_path: Path) -> None:
    text = "version: 1\nname: x\nmotion: {}\nsettings:\n  a: {{{}}}\n"
    (oncoming,) = read(tmp_path, text.format("oncoming", "gap: 30, speed: 5"))
    assert oncoming == Oncoming("a", 30.0, 5.0, None, 0.0, "x")
    (standing,) = read(tmp_path, text.format("stationary", "min_gap: 1, braking: 2, reserve: 3"))
    assert standing == Stationary("a", 1.0, 2.0, 3.0, 0.0, 0.0, "x")


@pytest.mark.parametrize("name", sorted(MOTIONS))
def test_records_read_back(name: str) -> None:
    assert motion_of_record(scenario_record(MOTIONS[name])) == MOTIONS[name]


def test_the_built_in_numbers() -> None:
    """As the specification has them: a slip in a file must not pass unseen."""
    found = {
        name: tuple(scenario_record(m)["settings"][m.setting].values())
        for name, m in MOTIONS.items()
    }
    assert found == {
        "cut-in-a": (6.0, 0.8, 0.5, 0.5, 2.5),
        "cut-in-b": (12.0, 0.7, 0.35, 1.0, 3.0),
        "oncoming-a": (35.0, 3.0, 15.0, 0.0),
        "oncoming-b": (55.0, 6.0, 25.0, 0.3),
        "oncoming-through-a": (35.0, 3.0, 0.0),
        "oncoming-through-b": (55.0, 6.0, 0.3),
        "stationary-a": (20.0, 3.6, 4.0, 0.0, 0.0),
        "stationary-b": (35.0, 2.4, 6.0, 0.17, 0.3),
        "advancing-a": (5.0, 0.5),
        "advancing-b": (12.0, 0.65),
    }


def test_the_example_of_the_documentation(tmp_path: Path) -> None:
    page = Path(__file__).parents[2] / "docs" / "scenarios.md"
    text = page.read_text().split("```yaml\n")[1].split("```")[0]
    (motion,) = read(tmp_path, text)
    assert motion.name == "hard-cut-in"
    with pytest.raises(InputError, match=r"my\.yaml:7: gap: is 'near'; give -50 to 500 m"):
        read(tmp_path, text.replace("gap: 4.0", "gap: near"))
