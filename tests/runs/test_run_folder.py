from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from recast.core import Artefact, files
from recast.core.artefact import folder_hash, value_hash
from recast.core.errors import InputError
from recast.reconstruction import resolve_config as scene_config
from recast.runs.config import RunConfig, resolve_config
from recast.runs.run_folder import RUN_FILE, RunFolder, use_name, use_parts


def start(path: Path, seed: int = 0, log_hash: str = "abc", store: str = "store") -> RunFolder:
    config = {"seed": seed, "scene": {"scale": 0.5}}
    beside = path.parent
    return RunFolder.create_or_resume(path, config, beside / "log", log_hash, str(beside / store))


def make(run: RunFolder, text: str = "whole", kind: str = "scenes") -> Artefact:
    return run.store().make(
        kind, {"text": text}, lambda out: files.write_text(out / "file.txt", text), name=text
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


def test_a_finished_file_is_left_until_what_it_was_made_from_changes(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    made: list[str] = []

    def finish(made_from: str) -> int:
        def write() -> None:
            made.append(made_from)
            (run.path / "out.txt").write_text("result")

        RunFolder.open(run.path).finish("out.txt", made_from, write)
        return len(made)

    assert (finish("x"), finish("x"), finish("y"), finish("y")) == (1, 1, 2, 2)
    (run.path / "out.txt").unlink()
    assert finish("y") == 3
    assert start(run.path).record.finished == {"out.txt": "y"}


def test_what_fails_is_not_finished(tmp_path: Path) -> None:
    run = start(tmp_path / "run")

    def fail() -> None:
        (run.path / "half.txt").write_text("half")
        raise RuntimeError("killed")

    with pytest.raises(RuntimeError):
        run.finish("half.txt", "x", fail)
    made: list[int] = []
    RunFolder.open(run.path).finish("half.txt", "x", lambda: made.append(1))
    assert made == [1]


def test_artefacts_are_noted_in_the_run_in_the_store_and_as_links(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    store, scene = run.store(), make(run)
    run.refer(store, {use_name("scene", "recast"): scene})
    assert (run.path / "scenes" / "recast" / "file.txt").read_text() == "whole"
    assert RunFolder.open(run.path).record.artefacts == {"scene/recast": scene.reference}
    assert store.users() == {run.path: (scene.reference,)}
    assert store.unused() == []
    found = RunFolder.open(run.path).artefact(store, "scene/recast")
    assert found is not None and found.path == scene.path
    assert run.artefact(store, "scene/omnire") is None


def test_a_run_that_goes_on_loses_nothing_before_its_end(tmp_path: Path) -> None:
    """What a first try used stays noted while a second one is on its way."""
    run = start(tmp_path / "run")
    store = run.store()
    one, two, three = (make(run, text) for text in ("one", "two", "three"))
    run.refer(store, {"scene/recast": one, "actor/replaced": two}, whole=True)
    again = start(run.path)
    before = changes(tmp_path)
    again.refer(store, {"scene/recast": one})
    assert changes(tmp_path) == before, "nothing is new"
    again.refer(store, {"scene/recast": three})
    both = {"scene/recast": three.reference, "actor/replaced": two.reference}
    assert RunFolder.open(run.path).record.artefacts == both
    assert store.unused() == [store.open(one.reference)]
    assert (run.path / "scenes" / "recast" / "file.txt").read_text() == "three"
    again.refer(store, {"scene/recast": three}, whole=True)
    assert [*RunFolder.open(run.path).record.artefacts] == ["scene/recast"]


def changes(folder: Path) -> dict[str, int]:
    return {str(path): path.lstat().st_mtime_ns for path in folder.rglob("*")}


def test_a_run_and_its_store_are_moved_together(tmp_path: Path) -> None:
    first = tmp_path / "first"
    run = start(first / "run")
    run.refer(run.store(), {"scene/recast": make(run)})
    shutil.copytree(first, tmp_path / "second", symlinks=True)
    shutil.rmtree(first)
    moved = start(tmp_path / "second" / "run")
    assert moved.record == run.record
    assert moved.store().root == tmp_path / "second" / "store"
    assert (moved.path / "scenes" / "recast" / "file.txt").read_text() == "whole"
    assert moved.store().users() == {moved.path: (moved.record.artefacts["scene/recast"],)}


def test_another_store_is_noted(tmp_path: Path) -> None:
    start(tmp_path / "run")
    assert start(tmp_path / "run", store="other").store().root == tmp_path / "other"
    assert RunFolder.open(tmp_path / "run").record.store == "../other"


def test_a_copy_without_links_goes_on_and_what_is_the_users_stays(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    scene, link = make(run), run.path / "scenes" / "recast"
    run.refer(run.store(), {"scene/recast": scene})
    link.unlink()
    shutil.copytree(scene.path, link)
    run.refer(run.store(), {"scene/recast": scene})
    assert (link / "file.txt").read_text() == "whole"
    (link / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="is a file or folder that does not belong to this run"):
        run.refer(run.store(), {"scene/recast": scene})
    assert (link / "notes.txt").read_text() == "mine"


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
    log, store = path.parent / "log", str(path.parent / "store")
    return RunFolder.create_or_resume(path, config.resolved(), log, "abc", store)


def test_a_preset_sets_the_scene_as_it_does_when_a_scene_is_trained_alone(tmp_path: Path) -> None:
    options = {"iterations": 1000, "scale": 0.25}
    alone = scene_config("omnire", None, options)
    assert resolve("omnire", **options).scene == alone

    file = tmp_path / "scene.json"
    file.write_text(json.dumps({"version": 1, "sh_degree": 2, "iterations": 30_000}))
    scene = resolve("omnire", scene_file=file, iterations=3000).scene
    assert (scene.sh_degree, scene.densify_by, scene.iterations) == (2, "absolute_norm", 3000)
    assert scene == scene_config("omnire", None, {"iterations": 3000, "sh_degree": 2})


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
        json.dumps({"version": 2, "track": "0", "motions": [], "preset": "omnire", "scene": scene})
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
    assert files.read_json(path / "run.json")["config"]["preset"] is None
    with pytest.raises(InputError, match="omnire: changes nothing"):
        resolve("omnire", file=path / "run.json")


def test_the_record_of_a_run_is_a_whole_configuration(tmp_path: Path) -> None:
    config = resolve()
    assert {"densify_by", "densify_pause"} <= config.resolved()["scene"].keys()
    folder = begin(tmp_path / "run", config)
    assert folder.config == config
    assert resolve(file=folder.path / "run.json").resolved() == config.resolved()


HOSTILE = (
    "..",
    "../../victim",
    "/victim",
    "a/../../victim",
    "",
    ".",
    "a\\b",
    "nul\0nul",
    "new\nline",
    "l" * 300,
    "%2F",
    "\u202eright to left",
    "con",
    "\ud800",
    "7",
    "7/8",
)


@pytest.mark.parametrize("what", ["actor", "rollout"])
def test_names_from_outside_never_become_paths(tmp_path: Path, what: str) -> None:
    """Neither do two names share a link, nor does one lead into the artefact of another."""
    (tmp_path / "victim").mkdir()
    run = start(tmp_path / "deep" / "run")
    names: list[tuple[str, ...]] = [(name,) for name in HOSTILE]
    names += [(one, two) for one in HOSTILE for two in ("7", "..", "8")]
    if what == "rollout":
        names = [("advancing-a", *(two * 2)[:2]) for two in names]
    uses = [use_name(what, *one) for one in dict.fromkeys(names)]
    assert [use_parts(use) for use in uses] == [(what, *one) for one in dict.fromkeys(names)]
    made = make(run, kind="actors")
    run.refer(run.store(), dict.fromkeys(uses, made))

    links = [path for path in run.path.rglob("*") if path.is_symlink()]
    assert len(links) == len(set(uses)) == len(uses)
    assert {link.resolve() for link in links} == {made.path.resolve()}
    assert [path.name for path in made.path.iterdir()] == ["file.txt"]
    assert not any(True for _ in (tmp_path / "victim").iterdir())
    assert {path.name for path in (tmp_path / "deep").iterdir()} == {"run", "store"}


def test_a_link_of_the_user_is_replaced_and_not_what_it_leads_to(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "years").write_text("of work")
    (run.path / "scenes").mkdir()
    (run.path / "scenes" / "recast").symlink_to(elsewhere)
    run.refer(run.store(), {"scene/recast": make(run)})
    assert [path.name for path in elsewhere.iterdir()] == ["years"]
    assert (elsewhere / "years").read_text() == "of work"
    assert (run.path / "scenes" / "recast" / "file.txt").read_text() == "whole"


DAMAGED = ["", "[]", "{}", "null", "[" * 5000, "1" * 5000, '{"version": 1}', "\x00", "NaN"]


@pytest.mark.parametrize("text", DAMAGED)
@pytest.mark.parametrize("name", ["run.json", "store.json", "artefact.json", "users"])
def test_a_damaged_record_is_one_line_that_names_it(tmp_path: Path, name: str, text: str) -> None:
    run = start(tmp_path / "run")
    made = make(run)
    run.refer(run.store(), {"scene/recast": made})
    [user] = (tmp_path / "store" / "users").iterdir()
    path = {
        "run.json": run.path / "run.json",
        "store.json": tmp_path / "store" / "store.json",
        "artefact.json": made.folder / "artefact.json",
        "users": user,
    }[name]
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        again = start(run.path)
        again.artefact(again.store(), "scene/recast")
        again.store().unused()
    assert caught.value.where == str(path)


@pytest.mark.parametrize("reference", ["../../../victim", "scenes/..", "scenes/", "x/y", "", "\0"])
def test_a_reference_never_leads_out_of_the_store(tmp_path: Path, reference: str) -> None:
    run = start(tmp_path / "run")
    run.refer(run.store(), {"scene/recast": make(run)})
    record = files.read_json(run.path / "run.json")
    record["artefacts"]["scene/recast"] = reference
    files.write_json(run.path / "run.json", record)
    with pytest.raises(InputError, match="reference: is not the name of an artefact"):
        again = start(run.path)
        again.artefact(again.store(), "scene/recast")


@pytest.mark.parametrize("member", ["log", "config", "store", "versions"])
def test_a_record_that_lacks_a_member_says_which(tmp_path: Path, member: str) -> None:
    run = start(tmp_path / "run")
    record = run.record.model_dump()
    for faulty in ({**record, member: [5]}, {k: v for k, v in record.items() if k != member}):
        (run.path / "run.json").write_text(json.dumps(faulty))
        with pytest.raises(InputError) as caught:
            start(run.path)
        assert caught.value.field == member


def test_a_start_that_was_killed_at_once_is_begun_again(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".run.json.partial").write_text("{")
    assert start(tmp_path / "run").record.config["seed"] == 0


def test_a_run_of_before_traffic_is_read_and_gone_on_with(tmp_path: Path) -> None:
    """Its record has `keep_other_actors`, which is `traffic` now."""
    config = RunConfig(track="0", motions=("advancing-a",))
    given = (tmp_path / "run", config.resolved(), tmp_path / "log", "hash", str(tmp_path / "store"))
    path = RunFolder.create_or_resume(*given).path / RUN_FILE
    record = json.loads(path.read_text())
    assert "traffic" not in record["config"]
    for kept, traffic in ((False, "none"), (True, "replay")):
        record["config"]["keep_other_actors"] = kept
        path.write_text(json.dumps(record))
        assert RunFolder.open(tmp_path / "run").config.traffic == traffic
        if not kept:
            assert RunFolder.create_or_resume(*given).config == config
