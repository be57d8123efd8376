"""The page's server without a browser: what is where, what is seen, and what it runs."""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.geometry import se3
from recast.viewer import Page, ViewInputs
from recast.viewer.panel_run import faded, track_evidence
from recast.viewer.panels import Browser, ExactView
from recast.viewer.stage import Shown, ViewerStage

pytest.importorskip("viser")


@pytest.fixture
def page(inputs: ViewInputs, tmp_path: Path) -> Iterator[Page]:
    found = Page(inputs, out=tmp_path / "scenarios", port=8120)
    found._sending.join()
    yield found
    found.close()


def seen(page: Page) -> set[str]:
    nodes = {**page.stage._nodes, **page.stage.splats.handles}
    return {name for name, handle in nodes.items() if handle.visible}


def actor_node(page: Page, arm: str) -> str:
    return page.stage.splats._actors[arm]["0"]


def test_the_actor_is_where_the_drive_has_it_and_only_that_of_the_arm_is_seen(page: Page) -> None:
    page.playback.go_to(6)
    pose = page.playback.drive.at(6)["0"]
    handle = page.stage.splats.handles[actor_node(page, "native")]
    assert handle.position == pytest.approx(pose[:3, 3])
    assert np.allclose(se3.quat_to_matrix(handle.wxyz), pose[:3, :3])
    assert actor_node(page, "native") in seen(page)
    assert actor_node(page, "replaced") not in seen(page)
    page.playback.select(arm="replaced")
    assert actor_node(page, "replaced") in seen(page)
    assert actor_node(page, "native") not in seen(page)


def test_a_street_that_arms_share_is_sent_once(page: Page) -> None:
    splats = page.stage.splats
    assert splats._streets["native"] == splats._streets["replaced"]
    street = len(page.playback.inputs.scenes["native"].background)  # type: ignore[union-attr]
    assert splats.total == splats.kept == street + 600 + 300


def test_an_arm_is_sent_when_it_is_first_shown(page: Page, inputs: ViewInputs) -> None:
    stage = ViewerStage(page.server, inputs, 10_000, ["native"])
    street = len(inputs.scenes["native"].background)  # type: ignore[union-attr]
    assert stage.splats.total == street + 600
    stage.show(Shown("advancing-a", "replaced", 0))
    assert stage.splats.total == street + 600 + 300
    stage.show(Shown("advancing-a", "native", 0))
    assert stage.splats.total == street + 600 + 300


def test_an_arm_without_gaussians_shows_boxes_and_the_road(page: Page) -> None:
    page.playback.select(arm="oracle")
    assert "/map/drivable" in seen(page)
    assert not any(name.startswith(("/street", "/actors", "/sky")) for name in seen(page))
    assert any(name.startswith("/boxes") for name in seen(page))


def test_layers_are_switched(page: Page) -> None:
    assert "/map/boundaries" in seen(page) and "/lidar" not in seen(page)
    page.stage.layers.symmetric_difference_update({"lanes", "LiDAR"})
    page.playback.refresh()
    assert "/map/boundaries" not in seen(page) and "/lidar" in seen(page)


def test_playing_moves_on_and_closing_ends_every_thread(inputs: ViewInputs) -> None:
    before = set(threading.enumerate())
    page = Page(inputs, port=8120)
    page.playback.play(True)
    end = monotonic() + 10
    while page.playback.step < 3 and monotonic() < end:
        sleep(0.05)
    assert page.playback.step >= 3
    page.close()
    left = [thread.name for thread in set(threading.enumerate()) - before]
    assert not [name for name in left if name.startswith("recast")]


def test_only_this_machine_is_listened_to_and_no_tunnel_is_opened(page: Page) -> None:
    assert page.server.get_host() == "127.0.0.1" and page.server.request_share_url() is None
    with socket.socket() as other:
        other.settimeout(1.0)
        assert other.connect_ex(("127.0.0.2", page.server.get_port())) != 0


@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        ("", "", None),
        ("", "http://127.0.0.1:8120", None),
        ("", "http://example.org", 403),
        ("", "null", 403),
        ("", "http://127.0.0.1:9", 403),
        ("example.org:8120", "http://example.org:8120", 403),
    ],
)
def test_pages_of_other_sites_cannot_talk_to_it(
    page: Page, host: str, origin: str, status: int | None
) -> None:
    place = f"127.0.0.1:{page.server.get_port()}"
    origin = origin.replace("127.0.0.1:8120", place)
    headers = {"Host": host or place} | ({"Origin": origin} if origin else {})
    # The page itself.
    asked = http.client.HTTPConnection(place)
    asked.request("GET", "/", headers=headers)
    response = asked.getresponse()
    assert response.status == (status or 200)
    if status is None:
        assert response.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
    asked.close()
    # Its WebSocket.
    asked = http.client.HTTPConnection(place)
    key = {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Version": "13"}
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket"} | key
    asked.request("GET", "/", headers=headers | upgrade)
    assert asked.getresponse().status == (status or 101)
    asked.close()


def test_two_pages_take_two_ports(page: Page, inputs: ViewInputs) -> None:
    other = Page(inputs, port=page.server.get_port())
    assert other.server.get_port() != page.server.get_port()
    other.close()


def test_fewer_gaussians_are_sent_if_that_is_asked_for(page: Page, inputs: ViewInputs) -> None:
    server, stage = page.server, ViewerStage(page.server, inputs, 100, inputs.scenes)
    assert (stage.splats.kept, stage.splats.total) == (100, page.stage.splats.total)
    stage.show(Shown("advancing-a", "native", 0))
    server.scene.reset()


def test_the_runner_runs_and_films_and_counts(inputs: ViewInputs) -> None:
    runner, told = inputs.runner, []
    assert runner is not None
    drive = runner.run(
        runner.motions["advancing-a"],
        "constant-velocity",
        "native",
        lambda done, of: told.append((done, of)),
    )
    film = next(iter(drive.cameras.values())).film
    assert film is not None and len(film) == len(drive) - 1
    assert told == sorted(told) and told[-1][0] <= told[-1][1]
    assert np.allclose(drive.at(0)["0"], inputs.scenarios["advancing-a"]["native"].at(0)["0"])


def test_a_planner_that_looks_needs_a_street(inputs: ViewInputs) -> None:
    runner = inputs.runner
    assert runner is not None
    with pytest.raises(InputError, match="has no scene to render"):
        runner.run(runner.motions["advancing-a"], "gtrs-mini", "oracle", lambda *_: None)


def test_the_exact_view_is_the_rasterizers(inputs: ViewInputs) -> None:
    drive = inputs.scenarios["advancing-a"]["native"]
    assert drive.rig is not None
    above = drive.rig[0].copy()
    above[:3, :3] = drive.rig[0][:3, :3] @ np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    above[2, 3] += 20
    picture = ExactView(inputs.scenes).picture("native", drive, 0, Browser(above, 1.0, 2.0))
    assert picture.shape == (320, 640, 3)
    middle, corner = picture[160, 320].astype(int), picture[0, 0].astype(int)
    assert abs(middle - 128).max() < 30 and abs(corner - [128, 178, 230]).max() <= 2


def test_evidence_has_words_and_the_vehicle_in_its_crop(inputs: ViewInputs) -> None:
    assert inputs.log is not None
    found = track_evidence(inputs.log, "0")
    assert "labelled for" in found.lines[0]
    if found.crops:
        assert found.crops[0][1].shape[2] == 3
    else:
        assert "no view" in found.lines[-1]
    rgba = np.zeros((1, 2, 4), np.uint8)
    rgba[0, 0] = 200, 100, 0, 255
    assert faded(rgba).tolist() == [[[200, 100, 0], [83, 83, 83]]]


def test_an_unknown_host_is_refused(inputs: ViewInputs) -> None:
    with pytest.raises(InputError, match="`host`"):
        Page(replace(inputs, runner=None), host="203.0.113.9", port=8120)


def test_a_page_shows_what_a_run_has_made_meanwhile(
    inputs: ViewInputs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """First the recording alone; the step stays where somebody stands, and playing goes on."""
    monkeypatch.setattr("recast.viewer.page.RENEW_EVERY", 0.05)
    recorded = {"recording": inputs.scenarios["recording"]}
    later = threading.Event()
    broken = iter([True])

    def renew() -> ViewInputs | None:
        if not later.is_set():
            return None
        if next(broken, False):
            raise OSError("run.json is being written")
        return replace(inputs, title="finished")

    page = Page(replace(inputs, scenarios=recorded, renew=renew), out=tmp_path, port=8130)
    try:
        page.playback.add("mine", "native", inputs.drives[0])
        page.playback.select("recording", "native")
        page.playback.go_to(4)
        page.playback.play(True)
        later.set()
        sleep(0.3)
        assert list(page.playback.inputs.scenarios) == ["recording", "mine"]
        page.playback.play(False)
        step = page.playback.step
        page._renewing.join(timeout=20.0)
        assert page.playback.inputs.title == "finished"
        assert list(page.playback.inputs.scenarios) == ["advancing-a", "recording", "mine"]
        assert (page.playback.scenario, page.playback.step) == ("recording", step)
        assert actor_node(page, "native") in seen(page)
    finally:
        page.close()
