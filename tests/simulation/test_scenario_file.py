from __future__ import annotations

import time
from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.simulation import (
    MOTIONS,
    CutIn,
    Oncoming,
    Stationary,
    motion_of_record,
    parse_motions,
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
        (
            "target_speed: 0.2",
            "target_speed: -1",
            "my.yaml:12: target_speed: is negative; give 0 to 5 of v_r",
        ),
        ("duration: 1.5", "duration: 0.0", "my.yaml:14: duration: is 0; give more than 0, at"),
        ("delay: 0.0", "delay: .nan", "my.yaml:13: delay: is '.nan'; give 0 to 60 s"),
        ("delay: 0.0", "delay: nan", "my.yaml:13: delay: is 'nan'; give 0 to 60 s"),
        ("delay: 0.0", "delay: 1:30", "my.yaml:13: delay: is '1:30'; give 0 to 60 s"),
        ("delay: 0.0", 'delay: "0.5"', "my.yaml:13: delay: is '0.5'; give 0 to 60 s"),
        ("delay: 0.0", "delay: true", "my.yaml:13: delay: is true; give 0 to 60 s"),
        ("delay: 0.0", "delay:", "my.yaml:13: delay: is empty; give 0 to 60 s"),
        ("delay: 0.0", "delay: [1]", "my.yaml:13: delay: is a list; give 0 to 60 s"),
        ("    delay: 0.0\n", "", "my.yaml:9: delay: is missing; give 0 to 60 s"),
        ("delay: 0.0", "dely: 0.0", "my.yaml:13: dely: is not known; did you mean delay?"),
        ("delay: 0.0", "side: 0.0", "my.yaml:13: side: is not known; choose one of gap, initial"),
        ("delay: 0.0", "gap: 5.0", "my.yaml:13: gap: is given twice, first in line 10; remove"),
        ("version: 1", "version: 2", "my.yaml:2: version: is the number 2, this recast reads 1"),
        ("version: 1", 'version: "1"', "my.yaml:2: version: is '1', this recast reads 1"),
        ("version: 1\n", "", "my.yaml:2: version: is missing; write version: 1"),
        ("motion: cut-in", "motion: cutin", "my.yaml:4: motion: is 'cutin'; choose one of cut-in,"),
        ("motion: cut-in", "motion: [a]", "my.yaml:4: motion: is a list; choose one of cut-in,"),
        ("name: hard-cut-in", "name: ../up", "my.yaml:3: name: is '../up'; use lower-case"),
        ("name: hard-cut-in", "name: 7", "my.yaml:3: name: is the number 7; use lower-case"),
        ("name: hard-cut-in\n", "", "my.yaml:2: name: is missing; give a name"),
        ("  near:", "  Near by:", "my.yaml:9: setting Near by: is 'Near by'; use lower-case"),
        ("description: >", "other: >", "my.yaml:5: other: is not known; choose one of version,"),
        ("motion: cut-in", "motion: cut-in: x", "my.yaml:4: YAML: cannot be read"),
        ("    delay", "\tdelay", "my.yaml:13: YAML: cannot be read"),
        ("  near:", "  ? [a]\n  : 1\n  near:", "my.yaml:9: YAML: has a key that is not a word"),
        (
            "delay: 0.0",
            "delay: !!python/object/apply:os.system [ls]",
            "my.yaml:13: YAML: has the tag tag:yaml.org,2002:python/object/apply:os.system",
        ),
        ("    delay: 0.0\n", "    <<: 1\n", "my.yaml:13: <<: is not known"),
        ("settings:\n", "settings: {}\nother:\n", "my.yaml:9: other: is not known"),
    ],
)
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
        ("- a\n", "my.yaml:1: scenario: is not a mapping of keys"),
        ("a: 1\n---\nb: 2\n", "my.yaml:2: YAML: cannot be read (but found another document)"),
        (
            "version: 1\nsettings: &a\n  x: *a\n",
            "my.yaml:3: YAML: holds an alias that refers to itself",
        ),
        (b"version: 1\nname: \xff\n", "my.yaml:2: file: is not UTF-8 text"),
        ("version: 1\n\nname: \x00\n", "my.yaml:3: YAML: holds a character"),
        ("[" * 5000, "my.yaml:1: YAML: is nested too deeply"),
        ("version: 1\nname: x\nmotion: advancing\nsettings:\n", "my.yaml:4: settings: is empty"),
        (
            "version: 1\nname: x\nmotion: advancing\nsettings:\n  a: 3\n",
            "my.yaml:5: setting a: is the number 3; give gap, speed below it",
        ),
    ],
)
def test_what_is_no_scenario(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    assert message in str(error.value)


def test_a_folder_is_no_scenario(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
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
        "cut-in-stop-a": (10.0, 0.9, 0.9, 0.5, 2.5, 0.5),
        "cut-in-stop-b": (16.0, 0.9, 0.9, 1.0, 3.0, 1.0),
        "oncoming-a": (35.0, 3.0, 15.0, 0.0),
        "oncoming-b": (55.0, 6.0, 25.0, 0.3),
        "oncoming-through-a": (35.0, 3.0, 0.0),
        "oncoming-through-b": (55.0, 6.0, 0.3),
        "stationary-a": (20.0, 3.6, 4.0, 0.0, 0.0),
        "stationary-b": (35.0, 2.4, 6.0, 0.17, 0.3),
        "advancing-a": (5.0, 0.5),
        "advancing-b": (12.0, 0.65),
        "crossing-a": (25.0, 1.4, -4.5, 0.0),
        "crossing-b": (30.0, 1.4, -4.5, 0.0, 0.0),
        "crossing-c": (25.0, 1.8, -4.5, 0.0, -0.5),
        "along-a": (12.0, 4.5, -2.5, -0.5, 0.5, 1.5),
        "along-b": (12.0, 4.5, -2.2, 0.0, 2.0),
        "log-replay-a": (),
        "idm-a": (1.0, 1.5, 2.0, 0.0),
        "idm-b": (0.7, 1.5, 2.0, 15.0, 0.0),
    }


def test_the_example_of_the_documentation(tmp_path: Path) -> None:
    page = Path(__file__).parents[2] / "docs" / "scenarios.md"
    text = page.read_text().split("```yaml\n")[1].split("```")[0]
    (motion,) = read(tmp_path, text)
    assert motion.name == "hard-cut-in"
    with pytest.raises(InputError, match=r"my\.yaml:7: gap: is 'near'; give -50 to 500 m"):
        read(tmp_path, text.replace("gap: 4.0", "gap: near"))


def bomb(levels: int) -> str:
    """A few hundred bytes that stand for 9 ** levels values."""
    lines = ["version: 1", "l0: &l0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    for level in range(1, levels):
        aliases = ", ".join([f"*l{level - 1}"] * 9)
        lines.append(f"l{level}: &l{level} [{aliases}]")
    return "\n".join(lines)


def chain(length: int) -> str:
    lines = ["version: 1", "l0: &l0 [1]"]
    lines += [f"l{i}: &l{i} [*l{i - 1}]" for i in range(1, length)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (bomb(9), r"my\.yaml:\d+: YAML: has more than 10000 values"),
        (bomb(60), r"my\.yaml:\d+: YAML: has more than 10000 values"),
        (chain(1200), r"my\.yaml:\d+: YAML: is nested too deeply"),
        ("a: " * 30 + "1", r"my\.yaml:\d+: YAML: cannot be read"),
        ("\n".join(" " * i + "- " for i in range(200)), r"my\.yaml:\d+: YAML: is nested"),
        ("{a: " * 400, r"my\.yaml:\d+: YAML: is nested too deeply"),
        ("- 1\n" * 20_000, r"my\.yaml:10000: YAML: has more than 10000 values"),
        ("? " * 3000, r"my\.yaml:\d+: YAML: "),
        ("a" * 100_001, r"my\.yaml: size: has 100001 bytes, 100000 are read at most"),
        ("a: &x\n  b: 1\n  <<: *x\n", r"my\.yaml:3: YAML: holds an alias that refers to itself"),
    ],
)
def test_what_would_take_all_memory_or_never_end(tmp_path: Path, text: str, message: str) -> None:
    began = time.process_time()
    with pytest.raises(InputError, match=message):
        read(tmp_path, text)
    assert time.process_time() - began < 10.0  # seconds; the limits keep it far below


@pytest.mark.parametrize(
    "number",
    [".inf", "inf", "-inf", "nan", "1e999", "-1e999", "9" * 5000, "0x10", "1_0", "\uff11", "1e"],
)
@pytest.mark.parametrize("key", ["gap", "duration", "stop_after"])
def test_numbers_that_are_none(tmp_path: Path, key: str, number: str) -> None:
    text = GOOD.replace("    delay: 0.0", "    stop_after: 1.0\n    delay: 0.0", 1)
    lines = [f"    {key}: {number}" if f" {key}:" in line else line for line in text.split("\n")]
    with pytest.raises(InputError, match=f"{key}: is "):
        read(tmp_path, "\n".join(lines))


HOSTILE = [
    "../x",
    "../../../../victim",
    "/etc/passwd",
    "a/b",
    "a\0b",
    "a\nb",
    "x" * 300,
    "\u202egnp.x",
    "a\u200bb",
    "<script>alert(1)</script>",
    "[/bold]",
    ".",
    "..",
    "~",
    "-a",
    "a-",
    "a--b",
    "CON ",
    "\u00e4",
    "\u212a",
    "",
]


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_names_are_refused_where_they_are_read(name: str) -> None:
    record = scenario_record(MOTIONS["cut-in-a"])
    cases = [
        ("name", {**record, "name": name}),
        ("setting", {**record, "settings": {name: record["settings"]["a"]}}),
        ("motion", {**record, "motion": name}),
    ]
    for field, changed in cases:
        with pytest.raises(InputError, match=field) as error:
            motion_of_record(changed)
        line = str(error.value)
        assert line.isprintable() and len(line) <= 300


@pytest.mark.parametrize("name", ["../x.yaml", "a\0b.yaml", "a\nb.yaml", "x" * 300 + ".yaml", "/"])
def test_a_hostile_path_of_a_scenario_is_one_line(name: str) -> None:
    with pytest.raises(InputError) as error:
        parse_motions(name)
    assert str(error.value).isprintable() and len(str(error.value)) <= 300


def deep(levels: int) -> object:
    value: object = 1
    for _ in range(levels):
        value = [value]
    return value


@pytest.mark.parametrize("value", [10**400, -(10**400), deep(900), {"a": deep(30)}])
def test_records_with_huge_or_deep_values_are_refused(value: object) -> None:
    record = scenario_record(MOTIONS["cut-in-a"])
    settings = {"a": {**record["settings"]["a"], "gap": value}}
    for changed in ({**record, "settings": settings}, {**record, "version": value}):
        with pytest.raises(InputError):
            motion_of_record(changed)
