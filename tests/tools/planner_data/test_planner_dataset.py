"""One synthetic world, drawn from, rendered and scored as for the real dataset."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from recast.core import open_store
from recast.core.errors import InputError
from recast.core.files import write_json
from recast.dynamics import PACIFICA
from recast.planning.gtrs import PRIMITIVES
from recast.planning.gtrs.expert import score_trajectories, touched
from recast.planning.types import ego_status
from recast.synthetic import make_world
from recast.weights import shipped_folder
from recast_tools.planner_data import reconstruction
from recast_tools.planner_data.dataset import FIRST_SEED, make_dataset
from recast_tools.planner_data.drive import MOMENTS, SampleDrive, begin_drive
from recast_tools.planner_data.stage import SampleStage, make_stage
from recast_tools.planner_training.samples import (
    DRIVE_KINDS,
    RECORD_FILE,
    RENDERERS,
    DatasetRecord,
    DriveKind,
    Renderer,
    SampleStore,
    world_folder,
)

pytest.importorskip("embreex")

RECORD = DatasetRecord(per_world=2, speeds=1, seconds=14.0, scenes=("roundabout-approach",))


@pytest.fixture(scope="module")
def stage() -> SampleStage:
    return make_stage("roundabout-approach", FIRST_SEED, 14.0)


@pytest.fixture(scope="module")
def expert(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of one world, driven by the expert."""
    folder = tmp_path_factory.mktemp("expert") / "data"
    assert make_dataset(folder, 1, RECORD) == 2
    return folder


def drives(
    stage: SampleStage, count: int, kinds: tuple[DriveKind, ...] = DRIVE_KINDS
) -> list[SampleDrive]:
    found = [begin_drive(stage, kinds, np.random.default_rng(seed)) for seed in range(count)]
    return [one for one in found if one is not None]


def test_drives_are_of_the_kinds_that_are_asked_for(stage: SampleStage) -> None:
    found = [one.kind for one in drives(stage, 12, ("oncoming", "cut-in"))]
    assert set(found) == {"oncoming", "cut-in"}


def test_situations_are_possible_and_follow_the_generator(stage: SampleStage) -> None:
    for seed in range(6):
        drive, again = (
            begin_drive(stage, DRIVE_KINDS, np.random.default_rng(seed)) for _ in range(2)
        )
        assert drive is not None
        assert again is not None
        np.testing.assert_array_equal(drive.state, again.state)
        found = drive.situation(3, np.random.default_rng(seed))
        assert found is not None
        assert not touched(found.states[0], found.obstacles, PACIFICA)
        assert np.ptp(found.states[:, :3], axis=0).max() == 0.0
        np.testing.assert_array_equal(found.states[0], drive.state)
        assert np.abs(found.states[:, 3] - drive.state[3]).max() <= 0.15 * drive.state[3] + 1e-9
        _, lateral = stage.route.project(found.states[0])
        assert abs(float(lateral)) <= 1.2 + 1e-6
        alone = found.without_actor()
        assert alone.actor is None
        assert len(found.obstacles) - len(alone.obstacles) == (found.actor is not None)


def test_a_drive_goes_on_from_where_its_driver_brought_it(stage: SampleStage) -> None:
    """Standing, it ends after three moments; the actor's future starts where it is by then."""
    standing, rng = np.zeros((40, 3)), np.random.default_rng(0)
    seen = 0
    for drive in drives(stage, 12):
        first = drive.situation(1, rng)
        assert first is not None
        drive.go(float(drive.state[3]) * np.arange(0.1, 4.1, 0.1)[:, None] * [1.0, 0.0, 0.0])
        then = drive.situation(1, rng)
        if then is None:
            continue
        moved = np.linalg.norm(then.states[0, :2] - first.states[0, :2])
        assert moved == pytest.approx(0.5 * first.states[0, 3], abs=0.5)  # half a second on
        if first.actor is not None and then.actor is not None:
            np.testing.assert_array_equal(
                first.actor.obstacle.poses[5:], then.actor.obstacle.poses[:-5]
            )
            seen += 1
        moments = 0
        while drive.situation(1, rng) is not None:
            drive.go(standing)
            moments += 1
        assert moments <= MOMENTS
    assert seen > 2


def test_an_expert_gets_through_most_drives(stage: SampleStage) -> None:
    """What no driver could master would teach nothing."""
    rng = np.random.default_rng(0)
    good = moments = 0
    for drive in drives(stage, 5):
        while (found := drive.situation(1, rng)) is not None:
            state = found.states[0]
            possible = PRIMITIVES.trajectories(ego_status(found.command, state)[None])[0]
            told = score_trajectories(possible, state, stage.road, found.obstacles)
            moments += 1
            good += bool(told.total.max() > 0.5)
            drive.go(possible[told.best].astype(np.float64))
    assert moments > 10
    assert good >= 0.9 * moments


def test_a_dataset_of_one_world(expert: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(expert, tmp_path / "data"))
    store = SampleStore(out)
    assert store.image(0).shape == (128, 512, 3)
    assert store.image(0).std() > 10
    assert store.scores.shape == (2, 1, 6, len(PRIMITIVES))
    assert store.status.shape == (2, 1, 8)
    assert store.by_renderer() == {"oracle": 2, "native": 0, "replaced": 0, "refined": 0}
    assert not (tmp_path / "store").exists()
    written = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    assert make_dataset(out, 2, RECORD) == 2
    assert all(path.stat().st_mtime_ns == then for path, then in written.items())
    with pytest.raises(InputError, match="settings"):
        make_dataset(out, 1, RECORD.model_copy(update={"seed": 1}))
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="another folder"):
        make_dataset(tmp_path, 1, RECORD)


@pytest.mark.slow
def test_a_reconstructed_world_shows_its_target_in_three_ways(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what the store holds gives the same bytes again."""
    monkeypatch.setattr(reconstruction, "_EVERY", 10)
    monkeypatch.setattr(reconstruction, "DEFAULT_GENERATOR", "template")
    record = DatasetRecord(
        per_world=6,
        speeds=1,
        seconds=14.0,
        scenes=("roundabout-approach",),
        reconstructed=1.0,
        street_steps=30,
    )
    out, again = tmp_path / "data", tmp_path / "again"
    make_dataset(out, 1, record)
    made = sorted(path.name for path in (tmp_path / "store").iterdir())
    assert {"actors", "logs", "scenes"} <= set(made)
    store = SampleStore(out)
    names = [RENDERERS[index] for index in store.renderer]
    assert set(names) <= set(RENDERERS[1:])
    assert (store.clues[:, 0] > 0).any()
    assert all(store.image(index).std() > 10 for index in range(6))
    twins = np.flatnonzero(store.twin >= 0)
    np.testing.assert_array_equal(store.renderer[twins], store.renderer[store.twin[twins]])

    def making(*_: object, **__: object) -> None:
        raise AssertionError("is in the store already")

    for name in ("drive_log", "train_scene", "make_actor", "refine_actor"):
        monkeypatch.setattr(f"recast.runs.making.{name}", making)
    make_dataset(again, 1, record)
    for path in sorted(path for path in out.rglob("*.*") if path.is_file()):
        assert (again / path.relative_to(out)).read_bytes() == path.read_bytes()
    # The same drives, whoever shows them.
    truth, native = (_shown_by(tmp_path / name, record, name) for name in ("oracle", "native"))
    np.testing.assert_array_equal(truth.status, native.status)
    np.testing.assert_array_equal(truth.scores, native.scores)
    assert (truth.image(0) != native.image(0)).any()


def _shown_by(out: Path, record: DatasetRecord, name: Renderer) -> SampleStore:
    make_dataset(out, 1, record.model_copy(update={"renderers": (name,)}))
    store = SampleStore(out)
    assert store.by_renderer()[name] == len(store)
    return store


@pytest.mark.parametrize(("where", "is_the_log"), [("street-3", True), ("/a/disk", False)])
def test_a_target_that_is_hardly_seen_is_no_error_and_a_full_disk_is_one(
    where: str, is_the_log: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(*_: object) -> None:
        raise InputError(where, "track target", "is too far away", "come nearer")

    source = SimpleNamespace(log=SimpleNamespace(name="street-3"))
    monkeypatch.setattr(reconstruction, "drive_world", lambda *_: SimpleNamespace(path=tmp_path))
    monkeypatch.setattr(reconstruction.SourceLog, "open", lambda _: source)
    monkeypatch.setattr(reconstruction, "train_street", lambda *_: None)
    monkeypatch.setattr(reconstruction, "register_vehicle", refuses)
    world = make_world("urban-straight", 3, 1.0)
    if is_the_log:
        assert reconstruction.reconstruct(world, open_store(tmp_path), 1) is None
    else:
        with pytest.raises(InputError, match="too far"):
            reconstruction.reconstruct(world, open_store(tmp_path), 1)


@pytest.mark.slow
def test_killed_and_repeated_it_has_the_same_bytes(tmp_path: Path) -> None:
    make_dataset(tmp_path / "whole", 4, RECORD, workers=2)
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from recast_tools.planner_data.dataset import make_dataset\n"
        "from recast_tools.planner_training.samples import DatasetRecord\n"
        f"record = DatasetRecord.model_validate({RECORD.model_dump()!r})\n"
        "folder = Path(sys.argv[1])\n"
        "make_dataset(folder / 'parts', 4, record)\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    first = subprocess.Popen(command)
    while not world_folder(tmp_path / "parts", 0).exists():
        assert first.poll() is None
        time.sleep(0.02)  # no world is made so fast: it is killed in the second one
    first.send_signal(signal.SIGKILL)
    first.wait()
    assert not world_folder(tmp_path / "parts", 1).exists()
    subprocess.run(command, check=True)
    for path in sorted((tmp_path / "whole").rglob("*.*")):
        other = tmp_path / "parts" / path.relative_to(tmp_path / "whole")
        if path.is_file():
            assert other.read_bytes() == path.read_bytes()


def test_a_planner_may_drive_and_datasets_go_together(expert: Path, tmp_path: Path) -> None:
    """Every second drive is the planner's; the training takes both folders as one."""
    record = RECORD.model_copy(update={"driver": "of-the-weights"})
    driver = shipped_folder("gtrs-mini")
    make_dataset(tmp_path / "planner", 1, record, driver=driver)
    both = SampleStore(expert, tmp_path / "planner")
    assert len(both) == 4
    parts = [SampleStore(folder) for folder in (expert, tmp_path / "planner")]
    np.testing.assert_array_equal(both.image(3), parts[1].image(1))
    twins = np.flatnonzero(both.twin >= 0)
    np.testing.assert_array_equal(both.twin[both.twin[twins]], twins)
    paces = PRIMITIVES.model_copy(update={"paces": PRIMITIVES.paces[:3]})
    few = RECORD.model_copy(update={"primitives": paces})
    shutil.copytree(expert, tmp_path / "other")
    write_json(tmp_path / "other" / RECORD_FILE, few.model_dump(mode="json"))
    with pytest.raises(InputError, match="primitives"):
        SampleStore(expert, tmp_path / "other")
    with pytest.raises(InputError, match="settings"):  # of another driver
        make_dataset(expert, 1, record, driver=driver)
