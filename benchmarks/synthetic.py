"""Cost of the synthetic sensors on a generated street: camera by stage, LiDAR, build, memory.

    OMP_NUM_THREADS=1 python benchmarks/synthetic.py
    OMP_NUM_THREADS=1 python benchmarks/synthetic.py --scene roundabout-approach --size 960 640

CPU milliseconds of the process, minimum of the repeats, so that other work on the machine disturbs
little. The stages repeat what `render_camera` does, on the same frame; `frame` is the call itself,
and `frame, nothing compiled` the reference: rays one by one, all arithmetic in numpy.

Threads or processes: embreex and numpy both give Python's lock up while they work (the last lines
of the output: another thread stands still for a few of some hundred ms), so threads can cast at the
same time. Yet a frame is a thousand short numpy calls that need the lock in between, and writing a
log is Python throughout: logs are rendered by processes, each with a scene of its own.
"""

from __future__ import annotations

import argparse
import resource
import threading
import time
from collections.abc import Callable
from unittest.mock import patch

import numpy as np

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.synthetic.rendering import WAYMO_TOP, RayScene, compiled, render_camera, scan_lidar
from recast.synthetic.rendering.lighting import (
    LightFilter,
    SkyLight,
    add_light_samples,
    sample_light,
    sky_light,
)
from recast.synthetic.rendering.rays import RayMesh, pixel_samples
from recast.synthetic.rendering.sensors import LONELY_SAMPLES, camera_rays
from recast.synthetic.rendering.shading import OFFSETS, borrow_light, edge_pixels, shade
from recast.synthetic.rendering.surface_points import surface_points, textured
from recast.synthetic.streets import make_street
from recast.synthetic.surface import concatenate
from recast.synthetic.vehicles import sample_vehicle

FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


class Setting:
    """A street, vehicles placed along the ego's route, and a camera on the ego."""

    def __init__(self, scene: str, vehicles: int, width: int, height: int, seed: int) -> None:
        self.street = make_street(scene, np.random.default_rng(seed), 100.0)
        models = {
            f"{i:02d}": sample_vehicle(np.random.default_rng([seed, i]), "sedan")
            for i in range(vehicles)
        }
        self.surfaces = {name: model.surface for name, model in models.items()}
        lanes = [self.street.map.lanes[lane].centreline for lane in self.street.ego_route]
        self._line = np.concatenate([np.asarray(line)[:, :2] for line in lanes])
        step = np.linalg.norm(np.diff(self._line, axis=0), axis=1)
        self._station = np.concatenate([[0.0], np.cumsum(step)])
        start = 85.0
        self.poses = {
            name: self.on_road(
                start + 10 + 6 * i, (0.0, 3.4, -3.4)[i % 3], model.size[2] / 2, np.pi * (i % 2)
            )
            for i, (name, model) in enumerate(models.items())
        }
        ahead = se3.from_rotation_translation(FORWARD, [1.5, 0, 0])
        self.camera = PinholeCamera(
            width, height, 1.06 * width, 1.06 * width, width / 2, height / 2
        )
        self.world_from_camera = self.on_road(start, 0.0, 2.1, 0.0) @ ahead
        self.world_from_lidar = self.on_road(start, 0.0, 2.2, 0.0)
        self.rays = RayScene(self.street.surface, self.surfaces)

    def on_road(self, station: float, left: float, z: float, turn: float) -> np.ndarray:
        """world_from_body, metres along and left of the ego's route."""
        here, there = (
            np.array([np.interp(s, self._station, self._line[:, k]) for k in (0, 1)])
            for s in (station, station + 1)
        )
        heading = np.arctan2(*(there - here)[::-1])
        place = [here[0] - np.sin(heading) * left, here[1] + np.cos(heading) * left, z]
        return se3.from_rotation_translation(se3.rotation_z(heading + turn), place)

    def frame(self, rays: RayScene | None = None) -> object:
        """One image; of another scene than the setting's if one is given."""
        return render_camera(
            rays or self.rays,
            self.street.sky,
            self.camera,
            self.world_from_camera,
            self.poses,
            rng=np.random.default_rng(0),
        )

    def scan(self) -> object:
        """One turn of the LiDAR."""
        return scan_lidar(
            self.rays, WAYMO_TOP, self.world_from_lidar, self.poses, np.random.default_rng(0)
        )


def cpu_ms(work: Callable[[], object]) -> tuple[float, object]:
    """CPU milliseconds of one call, and what it returned."""
    start = time.process_time()
    result = work()
    return (time.process_time() - start) * 1e3, result


class Stages:
    """Least time of each named stage, and results to go on with."""

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}

    def __call__(self, name: str, work: Callable[[], object]) -> object:
        ms, result = cpu_ms(work)
        self.ms[name] = min(self.ms.get(name, np.inf), ms)
        return result


def camera_stages(setting: Setting, stages: Stages) -> dict[str, float]:
    """Time the stages of one image; returns what shares of the pixels they treat."""
    camera, light = setting.camera, sky_light(setting.street.sky)
    height, width = camera.height, camera.width
    rng = np.random.default_rng(0)
    posed = setting.rays.posed(setting.poses)
    grid = camera.pixel_grid().reshape(-1, 2)

    def rays(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return camera_rays(camera, setting.world_from_camera, pixels)[:2]

    origins, directions = stages("rays", lambda: rays(grid))
    static = setting.rays.posed({})
    stages("cast, street alone", lambda: static.cast(origins, directions, coherent=True))
    hits = stages("cast", lambda: posed.cast(origins, directions, coherent=True))
    pixels, points = stages("points", lambda: surface_points(posed, origins, directions, hits))
    samples = [pixel_samples(height, width, rng).reshape(-1, 2)[pixels] for _ in range(2)]
    noisy = stages("light", lambda: sample_light(light, points, *samples))
    light_filter = LightFilter(points, pixels, height, width)
    lonely = light_filter.lonely()
    stages(
        "lonely light",
        lambda: add_light_samples(light, points, noisy, lonely, LONELY_SAMPLES, rng),
    )
    arriving = stages("filter", lambda: light_filter.smooth(noisy))
    angle = 1 / camera.fx
    stages("(textures)", lambda: textured(points, angle))
    shaded = stages("shade", lambda: shade(light, points, arriving, angle))
    edges = stages("edges", lambda: edge_pixels(points, pixels, shaded, light.white, height, width))

    def further() -> None:
        for offset in OFFSETS:
            ray = rays(grid[edges] + offset)
            index, others = surface_points(posed, *ray, posed.cast(*ray, coherent=True))
            borrowed, _ = borrow_light(
                points, pixels, arriving, others, edges[index], offset, height, width
            )
            shade(light, others, borrowed, angle)

    stages("4 rays at edges", further)
    return {
        "surface": len(points) / len(grid),
        "edges": len(edges) / len(grid),
        "lonely": len(lonely) / len(grid),
    }


def longest_pause(work: Callable[[], object]) -> tuple[float, float]:
    """Wall-clock ms of the work, and the longest that another thread stood still meanwhile."""
    done, longest = threading.Event(), [0.0]

    def watch() -> None:
        last = time.perf_counter()
        while not done.is_set():
            time.sleep(0.0005)
            now = time.perf_counter()
            longest[0], last = max(longest[0], now - last), now

    watcher = threading.Thread(target=watch)
    watcher.start()
    start = time.perf_counter()
    work()
    taken = time.perf_counter() - start
    done.set()
    watcher.join()
    return taken * 1e3, longest[0] * 1e3


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="urban-straight")
    parser.add_argument("--vehicles", type=int, default=8)
    parser.add_argument("--size", type=int, nargs=2, default=(480, 320))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    setting = Setting(options.scene, options.vehicles, *options.size, options.seed)
    triangles = len(setting.street.surface)
    vehicle = len(next(iter(setting.surfaces.values())))
    first, _ = cpu_ms(setting.frame)
    stages = Stages()
    shares: dict[str, float] = {}
    placed = concatenate(
        [setting.surfaces[name].transformed(pose) for name, pose in setting.poses.items()]
    )
    with patch.object(compiled, "library", lambda: None):
        reference = RayScene(setting.street.surface, setting.surfaces)
    for _ in range(options.repeats):
        stages("frame", setting.frame)
        with patch.object(compiled, "library", lambda: None):
            stages("reference", lambda: setting.frame(reference))
        stages("lidar", setting.scan)
        stages("build street", lambda: RayMesh(setting.street.surface))
        stages("build vehicles", lambda: RayMesh(placed))
        stages("sky table", lambda: SkyLight(setting.street.sky))
        shares = camera_stages(setting, stages)

    ms = stages.ms
    width, height = options.size
    print(f"{options.scene}: {triangles} triangles, {options.vehicles} vehicles of {vehicle}.")
    print(f"CPU ms, minimum of {options.repeats} repeats.\n")
    print(f"build of the street's hierarchy {ms['build street']:8.0f}")
    print(f"table of a sky                  {ms['sky table']:8.0f}")
    print(f"first frame of a process        {first:8.0f}  (textures drawn, sky tabulated)\n")
    print(f"frame {width} x {height}              {ms['frame']:12.0f}  share of frame")
    print(f"frame, nothing compiled {ms['reference']:17.0f}")
    names = (
        "rays",
        "cast",
        "points",
        "light",
        "lonely light",
        "filter",
        "(textures)",
        "shade",
        "edges",
        "4 rays at edges",
    )
    for name in names:
        print(f"    {name:18} {ms[name]:17.1f}  {100 * ms[name] / ms['frame']:5.0f} %")
    for name, share in shares.items():
        print(f"    pixels {name:18} {100 * share:10.1f} %")
    moved = ms["cast"] - ms["cast, street alone"]
    print(f"\nvehicles posed by moving rays: {moved:.0f} ms for a frame's primary rays; building")
    print(f"one mesh of them would take {ms['build vehicles']:.0f} ms a frame.")
    rays = len(WAYMO_TOP.elevations) * WAYMO_TOP.azimuths
    print(f"\nLiDAR, {rays} rays         {ms['lidar']:14.0f}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory, MB             {peak:12.0f}\n")

    origins = np.tile(np.float32(setting.world_from_lidar[:3, 3]), (8 * rays, 1))
    directions = np.tile(WAYMO_TOP.directions(), (8, 1))
    mesh = RayMesh(setting.street.surface)
    work: dict[str, Callable[[], object]] = {
        "embreex": lambda: mesh.first_hits(origins, directions),
        "numpy": lambda: [np.sin(origins) for _ in range(40)],
    }
    for name, job in work.items():
        taken, pause = longest_pause(job)
        print(f"{name}: another thread stood still for {pause:.0f} of {taken:.0f} ms")


if __name__ == "__main__":
    main()
