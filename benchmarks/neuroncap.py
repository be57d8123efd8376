"""NeuroNCAP's interfaces beside the same work in process.

    OMP_NUM_THREADS=1 python benchmarks/neuroncap.py                 # 64 requests a turn, 3 turns

The renderer's server is a process of its own, which one client asks as NeuroNCAP's engine does: one
image after the other. Every reply is compared with the bytes that this process makes itself. The
planner's client makes the bodies of /infer with six images of nuScenes' size, and a server of three
lines answers them. Milliseconds are CPU time, the least of the turns.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import psutil
from sensorsim import CAMERA, SCENE, VIEWS, painter
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from recast.cameras import CameraMount, PinholeCamera
from recast.core.web_server import WebServer
from recast.dynamics import make_state
from recast.geometry import Polyline, se3
from recast.logs.types import Trajectory
from recast.planning import PlannerInput, PlanningContext
from recast.planning.types import DrivingCommand, ReferenceRoute
from recast_bridges.json_service import JsonService
from recast_bridges.neuroncap import NcapService, ncap_app
from recast_bridges.neuroncap.planner import NeuroNcapPlanner, infer_body
from recast_bridges.neuroncap.service import CAMERAS, encode
from recast_bridges.requests import RenderRequest

POSES = [
    se3.exp([0.1 * view, 0.0, 0.2 * view, 0.0, 0.3 * math.sin(view), 0.0]) for view in range(VIEWS)
]
NUSCENES = PinholeCamera(1600, 900, 1266.0, 1266.0, 800.0, 450.0)


def serve(pipe: Connection, gaussians: int) -> None:
    """Serve until told to end."""
    app = ncap_app(NcapService(painter(gaussians), SCENE))
    with WebServer(app, "127.0.0.1", 0).in_background() as server:
        pipe.send(server.port)
        pipe.recv()


def rendering(args: Any) -> None:
    """Print the renderer's rows."""
    pipe, theirs = multiprocessing.Pipe()
    spawn = multiprocessing.get_context("spawn")
    child = spawn.Process(target=serve, args=(theirs, args.gaussians))
    child.start()
    service = JsonService.at(f"127.0.0.1:{pipe.recv()}", "renderer")
    process, own = psutil.Process(child.pid), painter(args.gaussians)
    print("format  in process  server  ratio  wrong replies")
    for kind in ("raw", "png", "jpg"):
        inside, outside, wrong = math.inf, math.inf, 0
        for _ in range(args.turns):
            began, wanted = time.process_time(), []
            for number in range(args.requests):
                view = RenderRequest(SCENE, CAMERA, POSES[number % VIEWS], 0, {})
                wanted.append(encode(own.draw(view), kind))
            inside = min(inside, (time.process_time() - began) / args.requests)
            before = sum(process.cpu_times()[:2])
            for number in range(args.requests):
                pose = POSES[number % VIEWS].tolist()
                body = {"pose": pose, "timestamp": 0, "camera_name": "front", "image_format": kind}
                data = service.send("POST", "/render_image", body, seconds=60, most_bytes=1 << 24)
                wrong += data != wanted[number]
            outside = min(outside, (sum(process.cpu_times()[:2]) - before) / args.requests)
        told = f"{1e3 * inside:7.1f} ms {1e3 * outside:6.1f} ms {outside / inside:6.2f} {wrong:6}"
        print(f"{kind:6} {told} of {args.turns * args.requests}")
    pipe.send(None)
    child.join()


def planning(args: Any) -> None:
    """Print the planner's rows."""
    answer = {"trajectory": [[4.0 * k, 0.0] for k in range(1, 7)], "aux_outputs": {}}

    async def answered(request: Request) -> Response:
        await request.body()
        return JSONResponse(answer)

    app = Starlette(
        routes=[
            Route(path, answered, methods=["GET", "POST"])
            for path in ("/alive", "/reset", "/infer")
        ]
    )
    rng, state = np.random.default_rng(0), make_state([0.0, 0.0, 0.0], 8.0)
    turns = {name: se3.rotation_z(np.deg2rad(look.yaw)) for name, look in CAMERAS.items()}
    forward = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    mounts = {
        name: CameraMount(NUSCENES, se3.from_rotation_translation(turn @ forward, np.zeros(3)))
        for name, turn in turns.items()
    }
    images = {name: rng.integers(0, 256, (900, 1600, 3), np.uint8) for name in CAMERAS}
    route = ReferenceRoute(Polyline(np.array([[0.0, 0.0], [500.0, 0.0]])), np.zeros(2), np.ones(2))
    drive = Trajectory(np.arange(2), np.tile(np.eye(4), (2, 1, 1)))
    context = PlanningContext(route, drive, cameras=mounts)
    names = {name: name for name in CAMERAS}
    seen = PlannerInput(0, 0, state, state[None], (), DrivingCommand.STRAIGHT, images)
    with WebServer(app, "127.0.0.1", 0).in_background() as server:
        planner = NeuroNcapPlanner(JsonService("planner", "127.0.0.1", server.port), "planner")
        planner.reset(context)
        spent = {"body": math.inf, "plan": math.inf}
        for _ in range(args.turns):
            for name, work in (
                ("body", lambda: infer_body(seen, context, names)),
                ("plan", lambda: planner.plan(seen)),
            ):
                began = time.process_time()
                work()
                spent[name] = min(spent[name], time.process_time() - began)
    print(f"six images of 1600 x 900: body {1e3 * spent['body']:.0f} ms, ", end="")
    print(f"a whole plan {1e3 * spent['plan']:.0f} ms with the server's part in it")


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--requests", type=int, default=64)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--gaussians", type=int, default=200_000)
    args = parser.parse_args()
    rendering(args)
    planning(args)


if __name__ == "__main__":
    main()
