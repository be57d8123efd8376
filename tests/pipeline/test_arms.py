"""Words, files and settings of arms."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.pipeline.arms import Arm, parse_arms, truth_of
from recast.pipeline.config import resolve_config
from recast.scene.store import SCENE_FILE


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


BAD = [
    ("[", "cannot be read"),
    ("{}", "are no list"),
    ("[]", "are no list"),
    ('[{"name": "x", "vehicle": "magic"}]', "vehicle"),
    ('[{"name": "", "vehicle": "own"}]', "name"),
    ('[{"name": "x", "vehicle": "truth"}]', "both the truth"),
    ('[{"name": "x", "vehicle": "own", "generator": "template"}]', "only a generated"),
    ('[{"name": "x", "vehicle": "own", "colour": "red"}]', "colour"),
    ("!!python/object/apply:os.system ['true']", "cannot be read"),
]


@pytest.mark.parametrize(("text", "said"), BAD)
def test_faulty_files_are_one_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "arms.yaml").write_text(text)
    with pytest.raises(InputError, match=said):
        parse_arms([str(tmp_path / "arms.yaml")])


def test_two_arms_of_one_name_and_a_truth_within_a_reconstruction() -> None:
    with pytest.raises(InputError, match="twice"):
        parse_arms(["native", "native"])
    with pytest.raises(InputError, match="truth"):
        parse_arms(["omnire+oracle"])


def test_assets_by_scene(tmp_path: Path) -> None:
    (tmp_path / "street-3.glb").write_bytes(b"x")
    [arm] = parse_arms([f"assets:{tmp_path}"])
    assert arm.of_scene("street-3").generator == str(tmp_path / "street-3.glb")
    with pytest.raises(InputError, match=r"scene street-4: has no file; add street-4\.ply"):
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
    with pytest.raises(InputError, match="holds no scene"):
        resolve_config("0", ["cut-in-a"], None, None, {"scene_folder": str(tmp_path)}, {})
