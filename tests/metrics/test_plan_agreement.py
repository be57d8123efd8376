"""Plans on rendered images against plans on the recorded ones."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.arrays import Array, Image
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.metrics.plan_agreement import (
    DENOISED,
    PARTS,
    PlanAgreement,
    mask_renderer,
    mixed,
    painted,
    plan_agreement,
    read_agreement,
    without_noise,
    write_agreement,
)
from recast.planning import ConstantVelocity, Plan, PlannerInput
from recast.scene import SceneActor, SkyMap, StreetScene
from recast.simulation.recorded_drive import RecordedDrive
from recast.simulation.renderer import MountedRenderer
from recast.simulation.rollout import SimState
from recast.splats import Gaussians
from support.recorded_drives import TIMES, Looker, car, log


class Shows(MountedRenderer):
    """The recorded images of a drive, changed; remembers the states that it drew."""

    def __init__(self, drive: RecordedDrive, change: Callable[[Image], Image]) -> None:
        super().__init__(drive.mounts)
        self._drive, self._change = drive, change
        self.states: list[SimState] = []

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        self.states.append(state)
        recorded = self._drive.images(state.timestamp_us)
        return {name: self._change(recorded[name]) for name in camera_names}


def brighter(image: Image) -> Image:
    return np.clip(image.astype(int) + np.array([6, 0, 0]), 0, 255).astype(np.uint8)


def measured(**options: object) -> tuple[PlanAgreement, dict[str, Shows]]:
    planner = Looker()
    drive = RecordedDrive(log(tracks=[car(30.0, speed=10.0)]), planner)
    shown = {"same": Shows(drive, lambda image: image), "brighter": Shows(drive, brighter)}
    return plan_agreement(planner, drive, shown, **options)[0], shown  # type: ignore[arg-type]


def test_equal_images_give_equal_plans_and_others_do_not() -> None:
    found, shown = measured(held_out=lambda camera, frame: camera == "cam" and frame % 2 == 1)
    same, other = found.scores("same"), found.scores("brighter")
    assert same is not None and other is not None
    assert (same.psnr, same.ade, same.fde, same.moved, same.near) == (100.0, 0.0, 0.0, 0.0, 1.0)
    # 6 of red are 6 m/s: 24 m at 4 s, where the planner does not stand
    assert other.moved == pytest.approx(0.8) and other.median == pytest.approx(24.0)
    assert other.other_decision == 0.0 and other.psnr is not None and 30.0 < other.psnr < 40.0
    kinds = {one.kind: one.moments for one in found.table if one.images == "same"}
    assert kinds == {"all": 10, "held out": 5, "trained on": 5}
    assert found.floor == 0.8  # one pixel is 2 of red
    assert found.worst()[0].differences["brighter"].fde == pytest.approx(24.0)
    # each at the time, the place and with the traffic of its own recorded image
    states = shown["same"].states
    assert [state.timestamp_us for state in states] == list(TIMES[1:51:5])
    assert states[0].world_from_rig[0, 3] == pytest.approx(2.0)
    assert list(states[0].poses) == ["7"] and not states[0].actors


def test_what_a_planner_remembers_is_of_one_kind_of_image() -> None:
    planner = Looker()
    drive = RecordedDrive(log(), planner)
    plan_agreement(planner, drive, {"brighter": Shows(drive, brighter)})
    steps = [seen.step for seen in planner.seen]
    assert steps == list(range(10)) * 5  # recorded, rendered, and three disturbances
    red = np.array([seen.images["virtual_left"][20, 30, 0] for seen in planner.seen], int)
    drives = red.reshape(5, 10)
    assert (np.abs(drives - drives[:, :1]) <= 2).all()
    assert (drives[1] - drives[0] == 6).all()


def test_moments_without_all_images_are_left_out() -> None:
    whole = log()
    stream = whole.cameras["cam"]
    kept = np.flatnonzero(np.arange(len(TIMES)) != 21)

    class Some:
        def __len__(self) -> int:
            return len(kept)

        def __getitem__(self, index: int, /) -> Image:
            return np.asarray(stream.images[int(kept[index])])

    class Both(Looker):
        wanted_views = ()

        def choose_cameras(self, mounts: object) -> Sequence[str]:
            return ["cam", "cam2"]

        def plan(self, observation: PlannerInput) -> Plan:
            assert set(observation.images) == {"cam", "cam2"}
            return Plan(np.zeros((40, 3)))

    gap = replace(stream, name="cam2", timestamps_us=TIMES[kept], images=Some())
    both = Both()
    drive = RecordedDrive(replace(whole, cameras={"cam": stream, "cam2": gap}), both)
    found, _ = plan_agreement(both, drive, {"x": Shows(drive, brighter)})
    assert (len(found.moments), found.left_out) == (9, 1)  # that of 2.1 s
    assert int(TIMES[21]) not in [one.timestamp_us for one in found.moments]
    planner = Looker()
    late = replace(stream, timestamps_us=TIMES + 10_000_000)
    nothing = RecordedDrive(replace(whole, cameras={"cam": late}), planner)
    with pytest.raises(InputError, match="no moment has"):
        plan_agreement(planner, nothing, {"x": Shows(nothing, brighter)})
    none = replace(stream, timestamps_us=TIMES[:0], images=Some())
    with pytest.raises(InputError, match="the log has none, but the planner uses images"):
        RecordedDrive(replace(whole, cameras={"cam": none}), planner)
    blind = RecordedDrive(whole, ConstantVelocity())
    with pytest.raises(InputError, match="looks at no images"):
        plan_agreement(ConstantVelocity(), blind, {"x": Shows(drive, brighter)})


class Corner:
    """Finds one box, where an image is brightest."""

    def detect(self, image: Image) -> Array:
        row, column = np.unravel_index(int(image[..., 0].argmax()), image.shape[:2])
        return np.array([[column, row, column + 10.0, row + 10.0]])


def test_a_detector_finds_the_same_boxes_on_the_same_image() -> None:
    class Turned(Corner):
        def detect(self, image: Image) -> Array:
            return np.zeros((2, 3))

    found, _ = measured(detector=Corner())
    same = found.scores("same")
    assert same is not None and same.boxes == 1.0
    with pytest.raises(InputError, match=r"returned boxes of shape \(2, 3\)"):
        measured(detector=Turned())


def test_it_is_read_as_it_was_written(tmp_path: Path) -> None:
    planner = Looker()
    drive = RecordedDrive(log(), planner)
    found, pictures = plan_agreement(planner, drive, {"brighter": Shows(drive, brighter)})
    write_agreement(found, pictures, tmp_path)
    again = read_agreement(tmp_path)
    assert [one.timestamp_us for one in again.worst()] == [o.timestamp_us for o in found.worst()]
    assert again.table[0].fde == pytest.approx(found.table[0].fde, abs=1e-5)
    assert len(list((tmp_path / "pictures").iterdir())) == 2 * len(found.worst())
    (tmp_path / "metrics.json").write_text(json.dumps({"moments": 3}))
    with pytest.raises(InputError, match="is no plan agreement"):
        read_agreement(tmp_path)


def noise(seed: int, shape: tuple[int, ...] = (40, 60, 3)) -> Image:
    return np.random.default_rng(seed).integers(60, 190, shape).astype(np.uint8)


def test_parts_are_taken_from_where_they_should_be() -> None:
    recorded, rendered = noise(0), noise(1)
    masks = np.zeros_like(recorded)
    masks[..., 1] = 255
    masks[10:20, 10:20, 0] = 255  # the vehicle
    masks[:5, :, 1] = 0  # the sky
    given: list[Mapping[str, Image]] = [{"a": recorded}, {"a": rendered}, {"a": masks}]
    made = {part: mixed(part, *given)["a"] for part in PARTS}
    inside, outside = (slice(8, 22), slice(8, 22)), (slice(23, 40), slice(0, 60))
    assert (made["vehicle alone"][inside] == rendered[inside]).all()
    assert (made["vehicle alone"][outside] == recorded[outside]).all()
    assert (made["vehicle recorded"][inside] == recorded[inside]).all()
    assert (made["vehicle recorded"][outside] == rendered[outside]).all()
    assert (made["sky recorded"][:5] == recorded[:5]).all()
    assert (made["sky recorded"][5:] == rendered[5:]).all()
    dark = (rendered * 0.5).astype(np.uint8)
    as_bright = mixed("contrast recorded", {"a": recorded}, {"a": dark}, given[2])["a"]
    assert as_bright.mean() == pytest.approx(recorded.mean(), abs=0.6)
    assert as_bright.std() == pytest.approx(recorded.std(), rel=0.02)


def test_a_blurred_image_gets_back_the_recorded_spectrum() -> None:
    import cv2

    recorded = noise(2, (64, 96, 3))
    blurred = np.asarray(cv2.GaussianBlur(recorded, (0, 0), 0.6))
    sharpened = mixed("spectrum recorded", {"a": recorded}, {"a": blurred}, {"a": recorded})["a"]
    before, after = (np.abs(one.astype(int) - recorded).mean() for one in (blurred, sharpened))
    assert after < 0.5 * before
    same = mixed("spectrum recorded", {"a": recorded}, {"a": recorded}, {"a": recorded})["a"]
    assert (same == recorded).all()


def test_noise_is_taken_out_and_edges_stay() -> None:
    clean = np.full((60, 80, 3), 90, np.uint8)
    clean[:, 40:] = 170
    random = np.random.default_rng(0)
    noisy = np.clip(clean + random.normal(0.0, 3.0, clean.shape), 0, 255).astype(np.uint8)
    found = without_noise({"a": noisy})["a"].astype(int)
    assert np.abs(found - clean).mean() < 0.6 * np.abs(noisy.astype(int) - clean).mean()
    assert np.abs(found[:, 38:42] - clean[:, 38:42]).max() < 15


def gaussians(x: float, y: float, size: float) -> Gaussians:
    return Gaussians(
        means=torch.tensor([[x, y, 1.5]]),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        log_scales=torch.full((1, 3), size).log(),
        logit_opacities=torch.full((1,), 6.0),
        sh=torch.zeros(1, 4, 3),
    )


def test_masks_show_the_vehicle_as_far_as_nothing_hides_it() -> None:
    mounts: Mapping[str, CameraMount] = RecordedDrive(log(), Looker()).mounts
    [name] = mounts
    mount = mounts[name]
    ahead = mount.rig_from_camera[:3, 2]  # 30 degrees to the left
    trajectory = car(0.0).trajectory
    place = np.tile(np.eye(4), (len(TIMES), 1, 1))
    origin = mount.rig_from_camera[:2, 3]
    place[:, :2, 3] = origin + 10.0 * ahead[:2]
    poses = replace(trajectory, poses=place)
    actor = SceneActor("7", gaussians(0, 0, 0.4), np.array([4.0, 2.0, 1.5]), poses)
    hidden = origin + 5.0 * ahead[:2]
    far = gaussians(200.0, 0.0, 0.1)
    for background, shown in ((far, True), (gaussians(*hidden, 0.3), False)):
        scene = StreetScene(background, {"7": actor}, SkyMap.constant(torch.ones(3)))
        state = RecordedDrive(log(), Looker()).state(int(TIMES[0]))
        state = replace(state, world_from_rig=np.eye(4), others={"7": place[0]})
        image = mask_renderer(scene, "7", mounts).render(state, [name])[name]
        assert (image[..., 2] == 0).all()
        height, width = image.shape[:2]
        middle = image[height // 2, width // 2]
        assert bool(middle[0] > 100) is shown
        assert middle[1] > 100 and image[0, 0, 1] == 0  # something there; sky


def test_paint_is_seen_from_all_sides() -> None:
    made = painted(gaussians(0, 0, 1.0), (1.0, 0.0, 0.5))
    assert made.sh.shape == (1, 1, 3)
    assert (0.5 + 0.28209479177387814 * made.sh[0, 0]).tolist() == pytest.approx([1.0, 0.0, 0.5])


def test_all_names_differ() -> None:
    assert len({*PARTS, DENOISED}) == len(PARTS) + 1
