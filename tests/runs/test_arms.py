"""Words, files and settings of arms."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.runs.arms import Arm, disturbed_arms, parse_arms, truth_of
from recast.runs.config import resolve_config
from recast.scene.store import SCENE_FILE
from recast.studies.verdicts import VerdictPart, parts_of


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """What looks like a scene's folder."""
    folder = tmp_path / "my" / "street"
    folder.mkdir(parents=True)
    (folder / SCENE_FILE).write_text("{}")
    return folder


def test_words(scene: Path) -> None:
    words = [
        "native",
        "replaced",
        "oracle",
        "recast-mini",
        "omnire",
        "omnire+template",
        "streetgs+replaced",
        str(scene),
        f"{scene}+cars/sedan.glb",
        "library:my/cars",
    ]
    arms = parse_arms(words)
    told = [(arm.name, Path(arm.street).name, arm.vehicle, arm.generator) for arm in arms]
    assert told == [
        ("native", "recast", "own", None),
        ("replaced", "recast", "generated", None),
        ("oracle", "truth", "truth", None),
        ("recast-mini", "recast", "generated", "recast-mini"),
        ("omnire", "omnire", "own", None),
        ("omnire+template", "omnire", "generated", "template"),
        ("streetgs+replaced", "streetgs", "generated", None),
        ("street", "street", "own", None),
        ("street+sedan.glb", "street", "generated", "cars/sedan.glb"),
        ("library:cars", "recast", "generated", "library:my/cars"),
    ]
    assert truth_of(arms) == "oracle" and truth_of(arms[:2]) is None
    assert parse_arms(["omnire+native"]) == parse_arms(["omnire"])


@pytest.mark.parametrize("suffix", [".json", ".yaml"])
def test_a_file_of_arms(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"arms{suffix}"
    record = [
        {"name": "ours", "vehicle": "generated", "generator": "template", "refine": False},
        {"name": "theirs", "street": "omnire", "vehicle": "own"},
    ]
    path.write_text(json.dumps(record))  # which is YAML too
    ours, theirs = parse_arms([str(path)])
    assert (ours.name, ours.refine, theirs.street) == ("ours", False, "omnire")


# Each list holds the one before ten times: 20 million values in 400 bytes.
_LISTS = ", ".join(f"&a{n} [" + ", ".join([f"*a{n - 1}"] * 10) + "]" for n in range(1, 8))
ALIASES = f"[&a0 [x, x], {_LISTS}]"

BAD = [
    ("[", "cannot be read"),
    ("{}", "not a list"),
    ("[]", "not a list"),
    ('[{"name": "x", "vehicle": "magic"}]', "vehicle"),
    ('[{"name": "", "vehicle": "own"}]', "name"),
    ('[{"name": "x", "street": "truth", "vehicle": "own"}]', "no reconstruction"),
    ('[{"name": "x", "vehicle": "truth", "noise": "seed"}]', "only the truth has camera noise"),
    ('[{"name": "x", "street": "truth", "vehicle": "none", "noise": "seed"}]', "camera noise"),
    ('[{"name": "x", "street": "truth", "vehicle": "truth", "noise": "loud"}]', "noise"),
    ('[{"name": "x", "vehicle": "none", "relit": false}]', "only a generated"),
    ('[{"name": "x", "vehicle": "own", "generator": "template"}]', "only a generated"),
    ('[{"name": "x", "vehicle": "own", "colour": "red"}]', "colour"),
    ("!!python/object/apply:os.system ['true']", "remove the tag"),
    ("- {vehicle: own, name: x, views: !!float x}", r"arms.yaml:1: views"),
    ("- {vehicle: own, name: x, views: !!int ''}", "views"),
    ("- {vehicle: own, name: x, views: !!bool maybe}", "views"),
    ("- {vehicle: own, name: x, views: 2001-99-99}", "views"),
    ("- &a {vehicle: own, name: *a}", "alias that refers to itself"),
    ("- {vehicle: own, name: x}\n- {vehicle: own, nam: y}", r"arms.yaml:2: nam"),
    (f"- {{vehicle: own, name: {ALIASES}}}", "more than 10000 values"),
    (f"- {{vehicle: own, name: {'[' * 400}{']' * 400}}}", "nested too deeply"),
]


@pytest.mark.parametrize(("text", "said"), BAD)
def test_faulty_files_are_one_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "arms.yaml").write_text(text)
    with pytest.raises(InputError, match=said):
        parse_arms([str(tmp_path / "arms.yaml")])


def test_two_arms_of_one_name() -> None:
    with pytest.raises(InputError, match="twice"):
        parse_arms(["native", "native"])


def test_words_of_noise_and_of_parts() -> None:
    words = ["oracle", "noise-floor", "omnire+oracle", "recast+oracle", "oracle+template"]
    arms = parse_arms([*words, "oracle+replaced", "recast+none", "oracle+none"])
    told = [(arm.name, arm.street, arm.vehicle, arm.generator, arm.noise) for arm in arms]
    assert told == [
        ("oracle", "truth", "truth", None, None),
        ("oracle:seed", "truth", "truth", None, "seed"),
        ("oracle:grey", "truth", "truth", None, "grey"),
        ("oracle:jitter", "truth", "truth", None, "jitter"),
        ("oracle:start", "truth", "truth", None, "start"),
        ("omnire+oracle", "omnire", "truth", None, None),
        ("recast+oracle", "recast", "truth", None, None),
        ("oracle+template", "truth", "generated", "template", None),
        ("oracle+replaced", "truth", "generated", None, None),
        ("recast+none", "recast", "none", None, None),
        ("oracle+none", "truth", "none", None, None),
    ]
    assert truth_of(arms[::-1]) == "oracle" and truth_of(arms[1:]) is None
    assert parse_arms(["oracle:grey"]) == arms[2:3]
    assert {arm.name for arm in arms if arm.start_left} == {"oracle:start"}
    assert len({str(arm.inputs()) for arm in arms[:6]}) == 6, "keys tell them apart"


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("oracle:loud", "cannot be disturbed by 'loud'; choose one of oracle:seed, oracle:grey"),
        ("recast+oracle:seed", "by 'seed'; choose one of recast.oracle:grey, .*:start, .*:noise"),
        ("oracle+native", "the true street has no reconstruction of the vehicle; give a"),
    ],
)
def test_bad_words_are_one_line(word: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        parse_arms([word])
    assert word in str(caught.value) and "\n" not in str(caught.value)


def test_any_arm_may_be_disturbed() -> None:
    arms = parse_arms(["replaced", "replaced:noise", "oracle+template:jitter", "native"])
    assert [arm.name for arm in arms] == [
        "replaced",
        *("replaced:grey", "replaced:jitter", "replaced:start"),
        "oracle+template:jitter",
        "native",
    ]
    assert disturbed_arms(arms[0], arms) == arms[1:4] and disturbed_arms(arms[5], arms) == ()
    assert parse_arms(["oracle:noise"]) == parse_arms(["noise-floor"])
    assert len({str(arm.inputs()) for arm in arms[:4]}) == 4, "keys tell them apart"
    assert [arm.start_left for arm in arms[2:4]] == [0.0, 0.05]


@pytest.mark.parametrize(("word", "plain"), [("noise-floor", "oracle"), ("omnire:grey", "omnire")])
def test_noise_without_what_it_disturbs_is_refused(word: str, plain: str) -> None:
    with pytest.raises(InputError, match=f"compared with the undisturbed arm.*add `arm` {plain}"):
        resolve_config("0", ["cut-in-a"], None, None, {"arms": ["native", word]}, {})


def test_parts_of_a_disagreement() -> None:
    config = resolve_config(
        "0", ["cut-in-a"], None, None, {"arms": ["decomposition", "noise-floor"]}, {}
    )
    assert parts_of([config.arm(arm.name) for arm in config.arms]) == (
        VerdictPart("street", "oracle", "recast+oracle"),
        VerdictPart("street", "oracle+replaced", "replaced"),
        VerdictPart("street", "oracle+none", "recast+none"),
        VerdictPart("vehicle", "oracle", "oracle+replaced"),
        VerdictPart("vehicle", "recast+oracle", "native"),
        VerdictPart("vehicle", "recast+oracle", "replaced"),
        VerdictPart("light", "replaced", "replaced, unlit"),
        VerdictPart("refinement", "replaced", "replaced, unrefined"),
        VerdictPart("no vehicle", "oracle", "oracle+none"),
        VerdictPart("no vehicle", "recast+oracle", "recast+none"),
    )


def test_assets_by_scene(tmp_path: Path) -> None:
    (tmp_path / "street-3.glb").write_bytes(b"x")
    [arm] = parse_arms([f"assets:{tmp_path}"])
    assert arm.of_scene("street-3").generator == str(tmp_path / "street-3.glb")
    with pytest.raises(InputError, match=r"scene street-4: has no vehicle file; add street-4\.ply"):
        arm.of_scene("street-4")
    assert Arm.native().of_scene("street-4") == Arm.native()


def test_streets_of_presets_keep_what_is_not_the_method_s() -> None:
    config = resolve_config(
        "0",
        ["cut-in-a"],
        None,
        None,
        {"arms": ["native", "omnire+template"], "refine": False},
        {"iterations": 900, "scale": 0.25},
    )
    assert set(config.streets) == {"omnire"}
    own, omnire = config.street("recast"), config.street("omnire")
    assert (own.sky, omnire.sky) == ("panorama", "cubemap")
    assert (omnire.iterations, omnire.scale) == (own.iterations, own.scale) == (900, 0.25)
    arm = config.arm("omnire+template")
    assert (arm.generator, arm.refine, arm.segmenter, arm.views) == (
        "template",
        False,
        config.segmenter,
        1,
    )


def test_a_run_s_record_gives_the_same_arms(tmp_path: Path) -> None:
    config = resolve_config("0", ["cut-in-a"], None, None, {"arms": ["native", "omnire"]}, {})
    file = tmp_path / "config.json"
    file.write_text(json.dumps(config.resolved()))
    assert resolve_config("0", [], file, None, {}, {}) == config


def test_a_folder_without_a_scene_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not a scene folder"):
        resolve_config("0", ["cut-in-a"], None, None, {"scene_folder": str(tmp_path)}, {})
