"""The sensorsim service under load, beside the same images rendered in process.

    OMP_NUM_THREADS=1 python benchmarks/sensorsim.py              # 64 clients, 1280 requests a turn
    OMP_NUM_THREADS=1 python benchmarks/sensorsim.py --clients 8 --requests 160 --turns 1

The server is a process of its own, each client a thread here with a channel of its own. Every reply
is compared with the bytes that this process makes itself. Milliseconds are CPU time an image, the
least of the turns, in process and of the server's process; a second count is of the wall clock.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import grpc
import numpy as np
import psutil
import torch
from raster import street

from recast.cameras import CameraMount, PinholeCamera
from recast.geometry import se3
from recast.scene import StreetScene
from recast.scene.sky import SkyMap
from recast.splats import set_threads
from recast_bridges.alpasim.messages import (
    CHANNEL_OPTIONS,
    JPEG,
    PLANAR,
    PNG,
    SENSORSIM_SERVICES,
    camera_message,
    encode,
    message,
    parse,
    pose_pair,
    read_requests,
)
from recast_bridges.alpasim.server import SensorsimServer, SensorsimService
from recast_bridges.rendering import ScenePainter, ServedScene

FORMATS = {"png": PNG, "jpeg": JPEG, "planar": PLANAR}
SCENE = "street"
CAMERA = PinholeCamera(512, 320, 400.0, 400.0, 256.0, 160.0)
PATH = f"/{SENSORSIM_SERVICES[0]}/render_rgb"
VIEWS = 16


def painter(gaussians: int) -> ScenePainter:
    """The same street in every process."""
    torch.set_num_threads(1)
    set_threads(1)
    scene = StreetScene(street(gaussians, degree=1), {}, SkyMap.constant(torch.full((3,), 0.6)))
    return ScenePainter(
        {SCENE: ServedScene(scene, {"front": CameraMount(CAMERA, np.eye(4))})}, "cpu"
    )


def serve(pipe: Connection, gaussians: int) -> None:
    """Serve until told to end."""
    with SensorsimServer(SensorsimService(painter(gaussians)), port=0) as server:
        pipe.send(server.port)
        pipe.recv()


def requests(image_format: int) -> list[Any]:
    """Views along the street, turned to either side."""
    found = []
    for index in range(VIEWS):
        turn = 0.3 * math.sin(index)
        pose = se3.exp([0.1 * index, 0.0, 0.2 * index, 0.0, turn, 0.0])
        found.append(
            message(
                "RGBRenderRequest",
                scene_id=SCENE,
                resolution_h=CAMERA.height,
                resolution_w=CAMERA.width,
                camera_intrinsics=camera_message(CAMERA, "front"),
                frame_start_us=index,
                frame_end_us=index,
                sensor_pose=pose_pair(pose),
                image_format=image_format,
                image_quality=95.0,
            )
        )
    return found


@dataclass(frozen=True)
class Load:
    """What came of all clients' requests: seconds, and how many replies were lost or wrong."""

    wall: float
    cpu: float
    lost: int
    wrong: int
    megabytes: list[float]


def load(
    process: psutil.Process, port: int, asked: list[bytes], wanted: list[bytes], args: Any
) -> Load:
    """Ask with all clients at once; the server's memory is taken at four times."""
    each = args.requests // args.clients
    sampled = []

    def client(number: int) -> tuple[int, int]:
        lost = wrong = 0
        with grpc.insecure_channel(f"127.0.0.1:{port}", options=CHANNEL_OPTIONS) as channel:
            ask = channel.unary_unary(PATH)
            for index in range(each):
                view = (number * 7 + index) % VIEWS
                try:
                    image = parse("RGBRenderReturn", ask(asked[view], timeout=600)).image_bytes
                    wrong += image != wanted[view]
                except grpc.RpcError:
                    lost += 1
                if number == 0 and (index + 1) % max(each // 4, 1) == 0:
                    sampled.append(process.memory_info().rss / 1e6)
        return lost, wrong

    before, began = sum(process.cpu_times()[:2]), time.perf_counter()
    with ThreadPoolExecutor(args.clients) as pool:
        outcomes = list(pool.map(client, range(args.clients)))
    wall, cpu = time.perf_counter() - began, sum(process.cpu_times()[:2]) - before
    lost, wrong = (sum(one) for one in zip(*outcomes, strict=True))
    return Load(wall, cpu, lost, wrong, sampled)


def in_process(own: ScenePainter, asked: list[Any], count: int) -> tuple[float, float, list[bytes]]:
    """CPU seconds of rendering and of encoding `count` images, and the bytes of each view."""
    views = read_requests(asked)
    rendering = encoding = 0.0
    found = []
    for index in range(count):
        view = views[index % VIEWS]
        begun = time.process_time()
        image = own.draw(view)
        drawn = time.process_time()
        data = encode(image, view.image_format, view.quality)
        rendering, encoding = rendering + drawn - begun, encoding + time.process_time() - drawn
        if index < VIEWS:
            found.append(data)
    return rendering, encoding, found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clients", type=int, default=64)
    parser.add_argument("--requests", type=int, default=1280)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--gaussians", type=int, default=200_000)
    parser.add_argument("--formats", nargs="+", choices=FORMATS, default=list(FORMATS))
    args = parser.parse_args()
    args.requests -= args.requests % args.clients
    context = multiprocessing.get_context("spawn")
    pipe, theirs = context.Pipe()
    process = context.Process(target=serve, args=(theirs, args.gaussians))
    process.start()
    try:
        port, server = pipe.recv(), psutil.Process(process.pid)
        own = painter(args.gaussians)
        print(
            f"{args.clients} clients, {args.requests} requests of {CAMERA.height}x{CAMERA.width}, "
        )
        print(f"{args.gaussians} Gaussians, {args.turns} turns; CPU ms an image\n")
        head = (
            "format",
            "render",
            "encode",
            "server",
            "/render",
            "/both",
            "img/s",
            "lost",
            "wrong",
        )
        print("".join(f"{word:>9}" for word in head), "  server's MB")
        for name in args.formats:
            asked = requests(FORMATS[name])
            sent = [one.SerializeToString() for one in asked]
            *_, wanted = in_process(own, asked, VIEWS)
            count = max(VIEWS, min(args.requests, 320))
            inside, outside = [], []
            for _ in range(args.turns):
                inside.append([1e3 * s / count for s in in_process(own, asked, count)[:2]])
                outside.append(load(server, port, sent, wanted, args))
            render, both = min(r for r, _ in inside), min(r + e for r, e in inside)
            cpu = min(1e3 * one.cpu / args.requests for one in outside)
            speed = max(args.requests / one.wall for one in outside)
            lost, wrong = sum(one.lost for one in outside), sum(one.wrong for one in outside)
            megabytes = " ".join(f"{m:.0f}" for one in outside for m in one.megabytes)
            row = (render, both - render, cpu, cpu / render, cpu / both, speed)
            cells = "".join(f"{number:9.2f}" for number in row)
            print(f"{name:>9}{cells}{lost:9d}{wrong:9d}   {megabytes}", flush=True)
    finally:
        pipe.send(None)
        process.join(60)


if __name__ == "__main__":
    main()
