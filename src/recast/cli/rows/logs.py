"""Rows of `recast log info`."""

from __future__ import annotations

from recast.cli.output import Rows
from recast.logs.info import LogInfo, TrackInfo


def log_rows(info: LogInfo) -> Rows:
    """The log, its sensors, its metadata, and its tracks: the best for replacing first."""
    log = {
        "name": info.name,
        "duration_s": info.seconds,
        "driven_m": info.ego_distance,
        "map_kind": info.map_kind,
        "lanes": info.lanes,
    }
    sensors = [
        {
            "name": one.name,
            "kind": one.kind,
            "frames": one.frames,
            "rate_hz": one.rate,
            "width_px": one.width,
            "height_px": one.height,
        }
        for one in info.sensors
    ]
    metadata = [{"name": name, "value": value} for name, value in info.metadata.items()]
    return {
        "log": [log],
        "sensors": sensors,
        "tracks": [_track(track) for track in info.tracks],
        "metadata": metadata,
    }


def _track(track: TrackInfo) -> dict[str, object]:
    length, width, height = track.size
    seen = track.visibility
    return {
        "track_id": track.track_id,
        "category": track.category,
        "usable": track.usable,
        "why": track.why,
        "length_m": length,
        "width_m": width,
        "height_m": height,
        "duration_s": track.seconds,
        "displacement_m": track.displacement,
        "lidar_points": track.lidar_points,
        "frames": seen.frames,
        "frames_front": seen.front,
        "frames_left": seen.left,
        "frames_rear": seen.rear,
        "frames_right": seen.right,
        "crop_width_px": seen.crop[0],
        "crop_height_px": seen.crop[1],
    }
