"""Portable checkpoints of MTGS (`NAME/background/NAME.ckpt`), which has published nuPlan scenes.

Source: Li et al., "MTGS: Multi-Traversal Gaussian Splatting" (2025), and the portable layout that
its trainer exports for renderers.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from recast.core.errors import InputError
from recast.core.files import require_new
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.scene.actor import SceneActor
from recast.scene.imported import ImportRecord, ScenePlacement, write_imported
from recast.scene.sky import sky_from_cubemap
from recast.scene.street_scene import StreetScene
from recast.splats import concatenate
from recast_bridges.scenes.actors import (
    SUSPICIOUS_M,
    TURNING,
    as_tracks,
    check_names,
    check_share,
    colours_in_own_frame,
    extent,
    find_tracks,
    read_track_names,
)
from recast_bridges.scenes.checkpoint import NO_SKY, RESAMPLED, CheckpointTable, read_checkpoint
from recast_bridges.scenes.drivestudio import CUBE_FROM_SCENE
from recast_bridges.scenes.mtgs_frames import (
    FRAMES_FILE,
    distance_to_log,
    read_drives,
    read_places,
)
from recast_bridges.scenes.mtgs_nodes import (
    MIRRORED,
    NAMES,
    RIGID,
    SCENERY,
    MtgsNode,
    read_gaussian_node,
    read_motion,
)
from recast_bridges.scenes.mtgs_odyssey import (
    CHECKPOINT,
    GROUND,
    exposed,
    lost,
    read_ego,
    read_environment,
    read_shift,
)

_SAME_LOG = "give the log of the same drive; see docs/howto/published_streets.md"


def import_mtgs(
    path: str | Path,
    log: DrivingLog,
    out: str | Path,
    *,
    tracks: Path | None = None,
    leave_out: Sequence[str] = (),
    share: float = 0.5,
) -> ImportRecord:
    """Make a scene of a portable MTGS checkpoint: scenery, sky, rigid and mirrored actors.

    Odyssey's sheets of ground and its cubemap of the sky are read as well.

    Args:
        path: the scene's folder, or its checkpoint. Only of a folder the recorded frames
            (video_scene_dict.pkl) are compared with the log's.
            An Odyssey scene (scene.ckpt) has the ego's places in the checkpoint.
        log: log of the drive that the scene was trained on.
        tracks: JSON file with the log's track ids by the actors' tokens.
        leave_out: tokens of actors not wanted.
        share: share of an actor's time in the scene, in [0, 1], at which its changing colour is
            frozen.

    Raises:
        InputError: a file is missing, broken or of another layout, no actor is there in the log's
            time, `out` exists. Nothing is written then.
    """
    check_share(share)
    require_new(out)
    folder, file = find_checkpoint(Path(path))
    root = read_checkpoint(file, arrays=True)
    nodes, left_out = read_nodes(root, leave_out)
    names = [name for name, node in nodes.items() if node.kind not in SCENERY]
    given = read_track_names(tracks)
    check_names(root, [*names, *leave_out], given, ())
    placement, warnings = _placement(root, log, folder)
    scenery = [read_gaussian_node(node, share) for node in nodes.values() if node.kind in SCENERY]
    if "background" not in nodes or "background" in names or len(scenery[0]) == 0:
        raise root.fault("background", "is missing, no scenery, or has no Gaussians")
    found: dict[str, SceneActor] = {}
    waves, gaps, elsewhere, moving = [], [], 0, 0
    for name in names:
        node = nodes[name]
        gaussians = read_gaussian_node(node, share)
        motion = read_motion(node, log, placement.world_from_scene)
        if motion is None or len(gaussians) == 0:
            left_out.append(f"actor {name}: is never present, or has no Gaussians")
            continue
        if not motion.meets(log):
            elsewhere += 1
            continue
        moving += not motion.static
        if node.changing:
            waves.append(name)
        if motion.gaps:
            gaps.append(name)
        own = colours_in_own_frame(gaussians, motion.trajectory, placement.world_from_scene, share)
        found[name] = SceneActor(name, own, extent(own.means), motion.trajectory)
    if elsewhere and not moving:
        raise root.fault(
            "log_timestamps", f"lie outside of log {log.name} for all actors", _SAME_LOG
        )
    adrift = [
        n
        for n, one in nodes.items()
        if one.kind == GROUND and lost(one.gaussians.tensor(NAMES.means, None, 3))
    ]
    motions = {name: actor.trajectory for name, actor in found.items()}
    chosen, told = find_tracks(root, log, motions, given, by_name=True)
    actors, keeping = as_tracks(root, log, found, chosen)
    if elsewhere:
        left_out.append(f"{elsewhere} actors of other drives: their times are not the log's")
    changed = [TURNING] if found else []
    if waves:
        changed.append(
            f"colours of {len(waves)} actors change; those over time are frozen at {share:g} of "
            "it, those with the angle of view are averaged"
        )
    if gaps:
        changed.append(
            f"{', '.join(gaps)}: absent for a while in the scene; interpolated in the import"
        )
    if adrift:
        changed.append(f"{', '.join(adrift)}: moved to the scene by recon2world_translation")
    changed += keeping
    warnings += told
    config = root.table("background").table("config")
    faces = read_environment(config)
    if faces is not None:
        changed.append(RESAMPLED)
    elif "skybox" not in nodes:
        left_out.append(NO_SKY)
    if exposed(config):
        left_out.append("exposure: corrections of single images")
    foreground = sorted(folder.glob("foreground/*.ckpt")) if folder else []
    if foreground:
        left_out.append(f"foreground: {len(foreground)} vehicles to be inserted")
    pose = torch.from_numpy(placement.world_from_scene)
    return write_imported(
        file,
        log,
        out,
        placement,
        StreetScene(
            concatenate(scenery).transformed(pose),
            actors,
            sky_from_cubemap(faces, CUBE_FROM_SCENE @ pose[:3, :3].T.float()),
        ),
        layout="mtgs",
        tracks=chosen,
        changed=changed,
        left_out=left_out,
        warnings=warnings,
    )


def find_checkpoint(path: Path) -> tuple[Path | None, Path]:
    """The scene's folder, if one is given, and its checkpoint.

    Raises:
        InputError: the folder has no checkpoint, or several.
    """
    if not path.is_dir():
        return None, path
    found = sorted(path.glob("background/*.ckpt"))
    if not found and (path / CHECKPOINT).is_file():
        return path, path / CHECKPOINT
    if len(found) != 1:
        problem = f"has {len(found)} files background/*.ckpt, one is needed"
        raise InputError(path, "scene folder", problem, "name the checkpoint itself")
    return path, found[0]


def read_nodes(
    root: CheckpointTable, leave_out: Sequence[str]
) -> tuple[dict[str, MtgsNode], list[str]]:
    """The nodes that are read, by token with the background first; what is left out."""
    nodes: dict[str, MtgsNode] = {}
    left_out = []
    tokens = [name.rpartition("_")[2] for name in root]
    for name in leave_out:
        if name not in tokens:
            raise root.fault(name, "is to be left out, but is not in the checkpoint", "check it")
    for name, token in sorted(zip(root, tokens, strict=True), key=lambda p: p[1] != "background"):
        node = MtgsNode.of(root, name, token)
        if token in leave_out:
            left_out.append(f"{token}: left out as requested")
        elif node.kind not in (*SCENERY, RIGID, MIRRORED):
            left_out.append(f"{name}: a {node.kind[:60]}, which is not rigid or not known")
        elif token in nodes:
            raise root.fault(name, f"is a second node with token {token}")
        else:
            nodes[token] = node
    return nodes, left_out


def _placement(
    root: CheckpointTable, log: DrivingLog, folder: Path | None
) -> tuple[ScenePlacement, list[str]]:
    """Where the scene lies in the log, and what looks wrong with it."""
    config = root.table("background").table("config")
    pose = se3.from_rotation_translation(np.eye(3), read_shift(config) - log.world_offset)
    how, warnings = "recon2world_translation of the checkpoint", []
    ego, file = read_ego(config), root.path
    if folder is not None and (folder / FRAMES_FILE).exists():
        file = folder / FRAMES_FILE
        ego = read_places([frame for frames in read_drives(file).values() for frame in frames])
    if ego is not None:
        distance, count = distance_to_log(*ego, pose, log)
        if count == 0:
            raise InputError(file, "timestamp", f"no frame is in log {log.name}", _SAME_LOG)
        how += f"; its ego is {distance:.2f} m from the log's (median of {count} frames)"
        if distance > SUSPICIOUS_M:
            warnings.append(f"the ego of the scene is {distance:.2f} m from the log's")
    return ScenePlacement(pose, how), warnings
