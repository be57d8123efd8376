from __future__ import annotations

import json
from pathlib import Path

import pytest

from recast.errors import InputError
from recast.pipeline.fingerprint import folder_hash, value_hash
from recast.pipeline.run_folder import RunFolder


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


def test_another_schema_version_is_refused(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    record = {**run.record, "schema": 99}
    (run.path / "run.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match="version 99"):
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
