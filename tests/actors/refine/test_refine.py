from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from actors import made_up_evidence
from recast.actors import Actor, insert, load_actor, save_actor
from recast.actors.evidence import Evidence
from recast.actors.insert import contact_shadow
from recast.actors.refine import Steps, refine
from recast.actors.refine.settings import REFINE
from recast.core.errors import InputError
from recast.geometry import se3
from recast.scene import StreetScene
from recast.splats import CLASSIC, Gaussians, concatenate
from support import made_up_actors as made_up

AROUND = np.linspace(0, 2 * np.pi, 13)[:-1]
FEW = Steps(shape=40, paint=10, free=20, look_every=10)
SHIFT = np.array([0.06, -0.04, 0.0])


@pytest.fixture(scope="module")
def scene(red_car: Gaussians) -> StreetScene:
    return made_up_evidence.empty_street(red_car, len(AROUND))


@pytest.fixture(scope="module")
def evidence(red_car: Gaussians) -> Evidence:
    return made_up_evidence.evidence(red_car, AROUND)


@pytest.fixture(scope="module")
def guess(actor: Actor) -> Actor:
    """A brown car of the right style, a hand's breadth beside its place."""
    grey = made_up.car(paint=np.array([0.45, 0.2, 0.2]))
    beside = se3.from_rotation_translation(np.eye(3), SHIFT)
    nothing = grey.select(torch.zeros(0, dtype=torch.int64))
    return dataclasses.replace(
        actor,
        gaussians=grey.transformed(torch.from_numpy(beside)),
        shadow=nothing,
        low_pass=CLASSIC,  # as the pictures were drawn
    )


@pytest.fixture(scope="module")
def refined(guess: Actor, evidence: Evidence, scene: StreetScene) -> Actor:
    return refine(guess, evidence, scene, steps=FEW)


def test_it_finds_place_and_paint(refined: Actor, guess: Actor, red_car: Gaussians) -> None:
    report = refined.provenance.refinement
    assert report is not None and report.kept and report.held_back > 0
    assert report.loss_before is not None and report.loss_after is not None
    assert report.loss_after < 0.85 * report.loss_before
    # Moved back by most of what it was off.
    moved = np.array(report.moved)
    assert np.linalg.norm(moved + SHIFT) < 0.75 * np.linalg.norm(SHIFT)
    red, green, blue = refined.gaussians.sh[:, 0].mean(dim=0).tolist()
    assert red > green + 0.1 and red > blue + 0.1
    assert report.seen > report.mirrored > 0
    assert refined.shares is not None and len(refined.shares) == len(refined.gaussians)


def test_the_shadow_follows_the_images(guess: Actor, red_car: Gaussians) -> None:
    """On the ground there is a grey patch beside the vehicle that no sun explains."""
    half = made_up.SIZE / 2
    shadow = contact_shadow(-half, half, -half[2])
    beside = shadow.means[:, 1].abs() < 0.3
    patch = dataclasses.replace(
        shadow.select(beside),
        means=shadow.means[beside] + torch.tensor([0.0, float(half[1]) + 0.5, 0.0]),
    )
    scene = made_up_evidence.empty_street(red_car, len(AROUND))
    alone = made_up_evidence.evidence(red_car, AROUND)
    both = made_up_evidence.evidence(concatenate([red_car, patch]), AROUND)
    sightings = tuple(
        dataclasses.replace(one, mask=other.mask)
        for one, other in zip(both.sightings, alone.sightings, strict=True)
    )
    evidence = dataclasses.replace(both, sightings=sightings)
    steps = Steps(shape=5, paint=20, free=5, look_every=5)
    actor = refine(dataclasses.replace(guess, shadow=shadow), evidence, scene, steps=steps)
    seen = actor.seen_shadow
    assert seen is not None
    opacity = torch.sigmoid(seen.logit_opacities)
    across = seen.means[:, 1]
    there = (seen.means[:, 0].abs() < 1.0) & ((across - half[1] - 0.5).abs() < 0.3)
    opposite = (seen.means[:, 0].abs() < 1.0) & ((across + half[1] + 0.5).abs() < 0.3)
    assert opacity[there].mean() > 1.3 * opacity[opposite].mean()


def test_same_seed_same_bytes(
    refined: Actor, guess: Actor, evidence: Evidence, scene: StreetScene
) -> None:
    again = refine(guess, evidence, scene, steps=FEW)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert torch.equal(getattr(again.gaussians, name), getattr(refined.gaussians, name))


def test_a_kill_changes_nothing(
    refined: Actor, guess: Actor, evidence: Evidence, scene: StreetScene, tmp_path: Path
) -> None:
    checkpoint = tmp_path / "checkpoint"

    def stop(done: int, total: int) -> None:
        if done == FEW.shape + 25:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        refine(guess, evidence, scene, steps=FEW, checkpoint=checkpoint, progress=stop)
    assert checkpoint.exists()
    told: list[int] = []
    again = refine(
        guess,
        evidence,
        scene,
        steps=FEW,
        checkpoint=checkpoint,
        progress=lambda done, _: told.append(done),
    )
    assert FEW.shape + 20 in told and FEW.shape + 19 not in told
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert torch.equal(getattr(again.gaussians, name), getattr(refined.gaussians, name))


def test_a_checkpoint_of_another_task_is_not_taken_up(
    refined: Actor, guess: Actor, evidence: Evidence, scene: StreetScene, tmp_path: Path
) -> None:
    checkpoint = tmp_path / "checkpoint"
    refine(guess, evidence, scene, seed=1, steps=FEW, checkpoint=checkpoint)
    again = refine(guess, evidence, scene, steps=FEW, checkpoint=checkpoint)
    assert torch.equal(again.gaussians.means, refined.gaussians.means)


def test_a_broken_checkpoint_is_one_line(
    guess: Actor, evidence: Evidence, scene: StreetScene, tmp_path: Path
) -> None:
    checkpoint = tmp_path / "checkpoint"
    checkpoint.write_bytes(b"no tensors")
    with pytest.raises(InputError, match="checkpoint"):
        refine(guess, evidence, scene, steps=FEW, checkpoint=checkpoint)


def test_too_few_images_leave_the_actor_and_say_so(
    guess: Actor, evidence: Evidence, scene: StreetScene
) -> None:
    few = dataclasses.replace(
        evidence,
        sightings=evidence.sightings[: REFINE.least_images - 1],
        left_out=("smaller than 14 pixels",) * 3,
    )
    kept = refine(guess, few, scene)
    assert kept.gaussians is guess.gaussians and kept.shares is None
    report = kept.provenance.refinement
    assert report is not None and not report.kept
    assert report.left_out == {"smaller than 14 pixels": 3}
    assert "not refined" in report.explain()


def test_never_worse_by_its_judges(guess: Actor, evidence: Evidence, scene: StreetScene) -> None:
    """Images that teach and images that judge are of two vehicles: the registered one stays."""
    judges = made_up_evidence.evidence(guess.gaussians, AROUND).sightings
    held = range(5, len(AROUND), 10)
    mixed = tuple(judges[i] if i in held else one for i, one in enumerate(evidence.sightings))
    kept = refine(guess, dataclasses.replace(evidence, sightings=mixed), scene, steps=FEW)
    report = kept.provenance.refinement
    assert report is not None and not report.kept
    assert kept.gaussians is guess.gaussians
    assert "the registered actor stays" in report.explain()


def test_evidence_of_another_track(guess: Actor, evidence: Evidence, scene: StreetScene) -> None:
    with pytest.raises(ValueError, match="track 8"):
        refine(guess, dataclasses.replace(evidence, track_id="8"), scene)


def test_a_folder_gives_it_back(refined: Actor, scene: StreetScene, tmp_path: Path) -> None:
    save_actor(refined, tmp_path / "actor")
    back = load_actor(tmp_path / "actor")
    assert back.provenance.refinement == refined.provenance.refinement
    assert back.shares is not None and refined.shares is not None
    assert torch.equal(back.shares.columns, refined.shares.columns)
    assert back.trajectory is not None and refined.trajectory is not None
    np.testing.assert_array_equal(back.trajectory.poses, refined.trajectory.poses)
    assert back.seen_shadow is not None and refined.seen_shadow is not None
    assert torch.equal(back.seen_shadow.sh, refined.seen_shadow.sh)
    # The scene takes the corrected poses with the vehicle.
    placed = insert(scene, back).actors["7"].trajectory
    np.testing.assert_array_equal(placed.poses, refined.trajectory.poses)


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("seen", None, "seen: is missing"),
        ("mirrored", torch.zeros(3), "Actor.shares.mirrored"),
        ("poses", torch.zeros(2, 4, 4), "poses: is torch.float32"),
    ],
)
def test_damaged_shares_are_one_line(
    refined: Actor, tmp_path: Path, name: str, value: torch.Tensor | None, problem: str
) -> None:
    from safetensors.torch import load_file, save_file

    save_actor(refined, tmp_path / "actor")
    path = tmp_path / "actor" / "refined.safetensors"
    tensors = load_file(path)
    tensors.pop(name)
    save_file(tensors if value is None else {**tensors, name: value}, path)
    with pytest.raises(InputError, match=problem):
        load_actor(tmp_path / "actor")


def test_an_actor_that_stayed_as_registered_is_read_back(
    guess: Actor, evidence: Evidence, scene: StreetScene, tmp_path: Path
) -> None:
    few = dataclasses.replace(evidence, sightings=evidence.sightings[: REFINE.least_images - 1])
    kept = refine(guess, few, scene)
    save_actor(kept, tmp_path / "actor")
    back = load_actor(tmp_path / "actor")
    assert back.provenance == kept.provenance
    assert back.shares is None and back.trajectory is None
