"""The page and a replay in Chromium: clicked through, and looked at.

With RECAST_VIEW_RUN, the folder of a demo's run, that is shown instead of a made-up street, and
the pictures of docs/view.md are taken anew. They skip, visibly, without Chromium
(/usr/bin/chromium, or CHROMIUM).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from recast.runs.view import view_inputs
from recast.viewer import Page, ViewInputs, write_replay

pytest.importorskip("viser")
sync_api = pytest.importorskip("playwright.sync_api")

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext
    from playwright.sync_api import Page as Tab

CHROMIUM = Path(os.environ.get("CHROMIUM", "/usr/bin/chromium"))
RUN = os.environ.get("RECAST_VIEW_RUN")
DOCS = Path(__file__).resolve().parents[2] / "docs" / "images"
FLAGS = (
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
SIZE = {"width": 1000, "height": 600} if RUN else {"width": 900, "height": 480}
PATIENCE = 240_000 if RUN else 60_000  # ms; without a GPU a frame of many Gaussians takes seconds
MOST = 150_000
SETTLED = 8_000 if RUN else 300  # ms

pytestmark = [
    pytest.mark.whole,
    pytest.mark.skipif(not CHROMIUM.exists(), reason=f"{CHROMIUM} not found: set CHROMIUM"),
]


@pytest.fixture(scope="module")
def shown(inputs: ViewInputs) -> ViewInputs:
    return view_inputs([Path(RUN)]) if RUN else inputs


@pytest.fixture(scope="module")
def page(shown: ViewInputs, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    out = tmp_path_factory.mktemp("view") / "scenarios"
    found = Page(shown, MOST, out, port=8130)
    yield found
    found.close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BrowserContext]:
    with sync_api.sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            tmp_path_factory.mktemp("profile"),
            executable_path=CHROMIUM,
            headless=True,
            viewport=SIZE,
            args=list(FLAGS),
        )
        context.set_default_timeout(PATIENCE)
        yield context
        context.close()


@pytest.fixture(scope="module")
def tab(page: Page, browser: BrowserContext) -> Tab:
    found = browser.new_page()
    found.goto(page.url)
    found.get_by_role("tab", name="Play").wait_for()
    close_notes(found)
    return found


def close_notes(tab: Tab) -> None:
    """Remove the note that there is no GPU, which lies over the picture."""
    tab.wait_for_timeout(SETTLED)
    tab.add_style_tag(content=".mantine-Notifications-root { display: none }")


def choose(tab: Tab, label: str, option: str) -> None:
    tab.get_by_role("combobox", name=label, exact=True).first.click()
    tab.get_by_role("option", name=option, exact=True).click()


def wait_until(true: Callable[[], Any], tab: Tab) -> None:
    for _ in range(PATIENCE // 100):
        if true():
            return
        tab.wait_for_timeout(100)
    raise AssertionError("it did not come to pass")


def picture(tab: Tab, name: str) -> None:
    """Take a picture for the docs, if they are made anew."""
    if RUN:
        tab.wait_for_timeout(SETTLED)
        image = screenshot(tab)
        image.quantize(160).save(DOCS / f"view-{name}.png", optimize=True)


def screenshot(tab: Tab) -> Image.Image:
    return Image.open(BytesIO(tab.screenshot())).convert("RGB")


def require_drawn(tab: Tab) -> None:
    """Wait until the scene is neither black nor of one colour."""

    def drawn() -> bool:
        image = np.asarray(screenshot(tab))
        return bool(image[60:-60, 20 : image.shape[1] * 3 // 5].std(axis=(0, 1)).max() > 5)

    wait_until(drawn, tab)


def test_the_street_is_seen(tab: Tab, page: Page) -> None:
    wait_until(page.server.get_clients, tab)
    require_drawn(tab)


def test_it_plays_and_stops(tab: Tab, page: Page) -> None:
    tab.get_by_role("button", name="Play", exact=True).click()
    wait_until(lambda: page.playback.step >= 2, tab)
    tab.get_by_role("button", name="Pause", exact=True).click()
    wait_until(lambda: not page.playback.playing, tab)


def test_it_seeks_by_steps_and_to_moments(tab: Tab, page: Page) -> None:
    page.playback.go_to(0)
    tab.get_by_role("button", name="+10").click()
    wait_until(lambda: page.playback.step == 10, tab)
    event = next(event for event in page.playback.drive.events if event.label == "plan 2")
    choose(tab, "Moment", f"{event.step * page.playback.drive.dt:.1f} s: plan 2")
    tab.get_by_role("button", name="Go to the moment").click()
    wait_until(lambda: page.playback.step == event.step, tab)


def test_arms_are_switched(tab: Tab, page: Page) -> None:
    choose(tab, "Arm", "replaced")
    wait_until(lambda: page.playback.arm == "replaced", tab)
    choose(tab, "Camera", "beside the actor")
    tab.get_by_role("button", name="go there").click()
    first = next(iter(page.server.get_clients().values()))
    actor = page.playback.drive.at(page.playback.step)
    place = actor[page.playback.drive.controlled[0]][:3, 3]
    wait_until(lambda: np.linalg.norm(first.camera.look_at - place) < 0.1, tab)


def test_the_camera_rides_along_and_is_let_go(tab: Tab, page: Page) -> None:
    window = next(iter(page.server.get_clients().values()))
    choose(tab, "Camera", "behind the ego")
    tab.get_by_role("button", name="follow").click()
    before = page.playback.step
    tab.get_by_role("button", name="+1", exact=True).click()
    rig = page.playback.drive.rig
    assert rig is not None
    wait_until(
        lambda: 8 < np.linalg.norm(window.camera.position - rig[before + 1][:3, 3]) < 11, tab
    )
    tab.get_by_role("button", name="release").click()
    picture(tab, "page")


def test_the_exact_view_replaces_the_splats(tab: Tab, page: Page) -> None:
    tab.get_by_role("checkbox", name="Exact view").dispatch_event("click")
    wait_until(lambda: page._exact._drawn, tab)
    tab.get_by_role("checkbox", name="Exact view").dispatch_event("click")
    wait_until(lambda: not page._exact._drawn, tab)


def test_layers_and_evidence_of_a_track(tab: Tab, page: Page) -> None:
    tab.get_by_role("tab", name="Play").click()
    choose(tab, "Camera", "beside the actor")
    tab.get_by_role("button", name="go there").click()
    tab.get_by_role("tab", name="Layers").click()
    tab.get_by_role("checkbox", name="Coverage colours").dispatch_event("click")
    wait_until(lambda: "coverage colours" in page.stage.layers, tab)
    picture(tab, "coverage")
    tab.get_by_role("checkbox", name="Coverage colours").dispatch_event("click")
    tab.get_by_role("tab", name="Track").click()
    choose(tab, "Track", page.playback.drive.controlled[0])
    tab.get_by_role("button", name="Show this track in the log").click()
    tab.get_by_text("labelled for").wait_for()


def test_a_rollout_is_run_and_saved(tab: Tab, page: Page) -> None:
    tab.get_by_role("tab", name="Run").click()
    choose(tab, "Motion", "cut-in-a" if RUN else "advancing-a")
    choose(tab, "Planner", "idm-follower")
    tab.get_by_role("checkbox", name="Show and drag the start").dispatch_event("click")
    tab.get_by_role("button", name="Run", exact=True).click()
    wait_until(lambda: page.playback.scenario == "my-motion, idm-follower", tab)
    tab.get_by_role("button", name="Save as a scenario file").click()
    tab.get_by_text("saved").wait_for()
    picture(tab, "run")


def test_two_windows_show_the_same(tab: Tab, page: Page, browser: BrowserContext) -> None:
    other = browser.new_page()
    other.goto(page.url)
    wait_until(lambda: len(page.server.get_clients()) == 2, other)
    page.playback.go_to(4)
    box = other.get_by_role("textbox", name="Step")
    wait_until(lambda: box.count() == 0 or box.first.input_value() == "4", other)
    other.close()
    wait_until(lambda: len(page.server.get_clients()) == 1, tab)


def test_a_replay_opens_from_disk_without_the_network(
    shown: ViewInputs, browser: BrowserContext, tmp_path: Path
) -> None:
    path = tmp_path / "replay.html"
    write_replay(shown, path, most=MOST)
    browser.set_offline(True)
    other = browser.new_page()
    asked: list[str] = []
    other.on("request", lambda request: asked.append(request.url))
    other.goto(path.as_uri())
    close_notes(other)
    require_drawn(other)
    picture(other, "replay")
    assert not [url for url in asked if not url.startswith(("file:", "blob:", "data:"))]
    other.close()
    browser.set_offline(False)
