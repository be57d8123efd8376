from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from recast import storage
from recast.errors import InputError
from recast.pipeline.config import RunConfig
from recast.pipeline.fingerprint import folder_hash, value_hash
from recast.pipeline.options import resolve_config
from recast.pipeline.run_folder import RunFolder
from recast.scene import resolve_config as scene_config


def start(path: Path, seed: int = 0, log_hash: str = "abc") -> RunFolder:
    return RunFolder.create_or_resume(
        path, {"seed": seed, "scene": {"scale": 0.5}}, "log", log_hash
    )


def test_a_second_start_with_the_same_configuration_resumes(tmp_path: Path) -> None:
    assert start(tmp_path / "run").record == start(tmp_path / "run").record


@pytest.mark.parametrize(
    ("seed", "log_hash", "field"), [(1, "abc", "config.seed"), (0, "other", "log.hash")]
)
def test_another_run_is_refused(tmp_path: Path, seed: int, log_hash: str, field: str) -> None:
    start(tmp_path / "run")
    with pytest.raises(InputError) as caught:
        start(tmp_path / "run", seed, log_hash)
    assert caught.value.field == field


def test_a_folder_with_foreign_files_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"run\.json"):
        start(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_another_version_is_refused(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    record = {**run.record.model_dump(), "version": 99}
    (run.path / "run.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match="version: is 99"):
        RunFolder.open(run.path)


def test_a_finished_step_is_skipped_until_its_inputs_change(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    made: list[int] = []

    def make() -> None:
        made.append(1)
        (run.path / "out.txt").write_text("result")

    first = run.step("a", {"x": 1}, make, ("out.txt",))
    assert first[1] and not run.step("a", {"x": 1}, make, ("out.txt",))[1]
    assert run.step("a", {"x": 2}, make, ("out.txt",))[1]
    (run.path / "out.txt").unlink()
    assert run.step("a", {"x": 2}, make, ("out.txt",))[1]
    assert len(made) == 3


def test_a_step_that_fails_leaves_no_marker_and_is_made_again(tmp_path: Path) -> None:
    run = start(tmp_path / "run")

    def fail() -> None:
        (run.path / "half.txt").write_text("half")
        raise RuntimeError("killed")

    with pytest.raises(RuntimeError):
        run.step("a", {}, fail, ("half.txt",))

    def make() -> None:
        assert not (run.path / "half.txt").exists()
        (run.path / "half.txt").write_text("whole")

    assert run.step("a", {}, make, ("half.txt",))[1]


def test_a_resuming_step_keeps_its_partial_output(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    (run.path / "scene").mkdir()
    (run.path / "scene" / "checkpoint").write_text("1000")
    seen: list[bool] = []
    run.step(
        "scene", {}, lambda: seen.append((run.path / "scene" / "checkpoint").exists()), ("scene",),
        keep_partial=True,
    )  # fmt: skip
    assert seen == [True]


def test_hashes_follow_the_content_and_not_the_order(tmp_path: Path) -> None:
    (tmp_path / "b").write_text("2")
    (tmp_path / "a").write_text("1")
    before = folder_hash(tmp_path)
    (tmp_path / "a").write_text("3")
    assert folder_hash(tmp_path) != before
    assert value_hash({"a": 1, "b": 2}) == value_hash({"b": 2, "a": 1})


def resolve(
    preset: str | None = None,
    file: Path | None = None,
    scene_file: Path | None = None,
    **scene: Any,
) -> RunConfig:
    return resolve_config("0", (), file, scene_file, {"preset": preset}, scene)


def begin(path: Path, config: RunConfig) -> RunFolder:
    return RunFolder.create_or_resume(path, config.resolved(), "log", "abc")


def test_a_preset_sets_the_scene_as_it_does_when_a_scene_is_trained_alone(tmp_path: Path) -> None:
    options = {"iterations": 1000, "scale": 0.25}
    alone = scene_config("omnire", None, {**options, "force_dynamic": ("0",)})
    assert resolve("omnire", **options).scene == alone

    file = tmp_path / "scene.json"
    file.write_text(json.dumps({"version": 1, "sh_degree": 2, "iterations": 30_000}))
    scene = resolve("omnire", scene_file=file, iterations=3000).scene
    assert (scene.sh_degree, scene.densify_by, scene.iterations) == (2, "absolute_norm", 3000)
    assert scene == scene_config(
        "omnire", None, {"iterations": 3000, "sh_degree": 2, "force_dynamic": ("0",)}
    )


@pytest.mark.parametrize(("first", "second"), [("omnire", "streetgs"), ("omnire", None)])
def test_a_run_goes_on_with_its_preset_alone(
    tmp_path: Path, first: str, second: str | None
) -> None:
    path = tmp_path / "run"
    record = begin(path, resolve(first)).record
    assert record.config["preset"] == first
    assert begin(path, resolve(first)).record == record
    with pytest.raises(InputError, match="another configuration") as caught:
        begin(path, resolve(second))
    assert caught.value.field == "config.preset"
    assert begin(path, resolve(file=path / "run.json")).record == record
    assert begin(path, resolve(first, file=path / "run.json")).record == record


def test_the_record_keeps_what_was_chosen_against_the_preset(tmp_path: Path) -> None:
    file = tmp_path / "config.json"
    scene = {"version": 1, "densify_pause": 0.0}  # as without a preset
    file.write_text(
        json.dumps({"version": 1, "track": "0", "motions": [], "preset": "omnire", "scene": scene})
    )
    with pytest.raises(InputError, match="motions"):
        resolve(file=file)
    file.write_text(file.read_text().replace("[]", '["cut-in-a"]'))
    config = resolve(file=file)
    assert (config.scene.densify_pause, config.scene.sh_degree) == (0.0, 3)
    path = begin(tmp_path / "run", config).path
    assert resolve(file=path / "run.json") == config
    assert resolve("streetgs", file=file).scene.fourier_terms == 5  # the option goes before


def test_a_preset_over_the_record_of_another_run_is_refused(tmp_path: Path) -> None:
    path = begin(tmp_path / "run", resolve()).path
    assert "preset" not in storage.read_json(path / "run.json")["config"]
    with pytest.raises(InputError, match="omnire: changes nothing"):
        resolve("omnire", file=path / "run.json")


def test_runs_begun_before_there_were_these_choices_go_on(tmp_path: Path) -> None:
    config = resolve()
    assert not {"densify_by", "densify_pause"} & config.resolved()["scene"].keys()
    folder = begin(tmp_path / "run", config)
    assert resolve(file=folder.path / "run.json").resolved() == config.resolved()


@pytest.mark.parametrize("output", ["../victim", "/victim", "a/../../victim", "", "a\\b"])
def test_a_step_never_leaves_the_folder(tmp_path: Path, output: str) -> None:
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "years").write_text("of work")
    run = start(tmp_path / "run")
    with pytest.raises(InputError, match="no file inside of run/"):
        run.step("a", {}, lambda: None, (output,))
    assert (victim / "years").read_text() == "of work"


def test_a_link_among_the_outputs_is_removed_and_not_what_it_leads_to(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "years").write_text("of work")
    (run.path / "scene").symlink_to(elsewhere)
    run.step("scene", {}, lambda: (run.path / "scene").mkdir(), ("scene",))
    assert (elsewhere / "years").read_text() == "of work"
    assert not (run.path / "scene").is_symlink()


DAMAGED = ["", "[]", "{}", "null", "[" * 5000, "1" * 5000, '{"version": 1}', "\x00", "NaN"]


@pytest.mark.parametrize("text", DAMAGED)
@pytest.mark.parametrize("name", ["run.json", "steps/a.json", "timings.json"])
def test_a_damaged_record_is_one_line_that_names_it(tmp_path: Path, name: str, text: str) -> None:
    run = start(tmp_path / "run")
    run.step("a", {}, lambda: None)
    assert run.timings().keys() == {"a"}
    (run.path / name).write_text(text)
    if (name, text) == ("timings.json", '{"version": 1}'):
        assert run.timings() == {}  # which is what it says
        return
    with pytest.raises(InputError) as caught:
        again = start(run.path)
        again.step("a", {}, lambda: None)
        again.timings()
    assert caught.value.where == str(run.path / name)


@pytest.mark.parametrize("member", ["log", "config", "versions"])
def test_a_record_that_lacks_a_member_says_which(tmp_path: Path, member: str) -> None:
    run = start(tmp_path / "run")
    record = run.record.model_dump()
    for faulty in ({**record, member: 5}, {k: v for k, v in record.items() if k != member}):
        (run.path / "run.json").write_text(json.dumps(faulty))
        with pytest.raises(InputError) as caught:
            start(run.path)
        assert caught.value.field == member


def test_an_old_time_does_not_stand_in_the_way(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    run.step("a", {}, lambda: None)
    run.step("b", {}, lambda: None)
    run.step("a", {"x": 1}, lambda: None)
    assert sorted(run.timings()) == ["a", "b"]


def test_a_start_that_was_killed_at_once_is_begun_again(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".run.json.partial").write_text("{")
    assert start(tmp_path / "run").record.config["seed"] == 0
