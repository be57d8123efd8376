"""The page in Chromium, opened from disk with the network off: played, stepped, sought, printed.

Without Chromium (/usr/bin/chromium, or CHROMIUM), these tests skip, visibly. With RECAST_VIEW_RUN,
the folder of a demo's run, its report is clicked through as well, and the pictures of
docs/report.md are taken anew.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from recast.metrics import rollout_metrics
from recast.reporting import ReportInputs, RolloutPart, ScenarioPart, write_report, write_video
from recast.runs.report import report_run
from reporting.made_up_rollouts import cut_in, straight_map

sync_api = pytest.importorskip("playwright.sync_api")

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext, Locator, Page

CHROMIUM = Path(os.environ.get("CHROMIUM", "/usr/bin/chromium"))
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
RUN = os.environ.get("RECAST_VIEW_RUN")
DOCS = Path(__file__).resolve().parents[2] / "docs" / "images"
STEPS = 20
ARMS = {"native": "Native", "replaced": "Replaced"}
TIMES = "[...document.querySelectorAll('video[data-film]')].map(film => film.currentTime)"
READY = "[...document.querySelectorAll('video[data-film]')].every(film => film.readyState > 1)"

pytestmark = pytest.mark.skipif(not CHROMIUM.exists(), reason=f"{CHROMIUM} not found: set CHROMIUM")


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two arms, a camera each, and a replay."""
    folder = tmp_path_factory.mktemp("run")
    parts = []
    for arm, brake in (("native", 0.0), ("replaced", 2.0)):
        rollout = cut_in(arm, steps=STEPS, brake=brake, cut=False)
        film = folder / f"{arm}.mp4"
        shades = np.linspace(20, 220, STEPS).astype(np.uint8)
        write_video(film, [np.full((64, 96, 3), shade, np.uint8) for shade in shades])
        metrics = rollout_metrics(rollout, straight_map())
        parts.append(RolloutPart(arm, rollout, metrics, {"front": film}))
    replay = folder / "scene.html"
    replay.write_text("<!doctype html><title>the moving scene</title>")
    run = ReportInputs(
        "Car 0",
        "log",
        ARMS,
        scenarios=(ScenarioPart("Cut-in", "", tuple(parts)),),
        hd_map=straight_map(),
        replay=replay,
    )
    return write_report(run, folder / "report")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BrowserContext]:
    with sync_api.sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            tmp_path_factory.mktemp("profile"),
            executable_path=CHROMIUM,
            headless=True,
            offline=True,
            viewport={"width": 1280, "height": 900},
            args=list(FLAGS),
        )
        yield context
        context.close()


@pytest.fixture
def page(browser: BrowserContext, page_file: Path) -> Iterator[Page]:
    """The page with all films loaded; it must complain about nothing."""
    found, complaints = browser.new_page(), []
    found.on("pageerror", lambda error: complaints.append(str(error)))
    found.on("console", lambda message: complaints.append(message.text))
    found.goto(page_file.as_uri())
    found.locator(".player").scroll_into_view_if_needed()
    found.wait_for_function(READY)
    yield found
    found.close()
    assert complaints == []


def test_one_button_plays_all_films_in_step(page: Page) -> None:
    films = page.locator("video[data-film]")
    assert films.count() == 4
    before = [films.nth(i).screenshot() for i in range(4)]
    page.locator("[data-play]").click()
    page.wait_for_function(f"{TIMES}.every(time => time > 0.6)")
    times = page.evaluate(TIMES)
    assert max(times) - min(times) < 0.2, "no film is more than two steps from another"
    page.locator("[data-play]").click()
    assert page.locator("[data-play]").text_content() == "▶ Play"
    stopped = page.evaluate(TIMES)
    page.wait_for_timeout(250)
    assert page.evaluate(TIMES) == stopped
    assert all(films.nth(i).screenshot() != before[i] for i in range(4)), "all pictures moved"


def test_keys_step_and_play(page: Page) -> None:
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    assert page.locator("[data-time]").text_content() == "0.2 s"
    assert page.evaluate(TIMES) == pytest.approx([0.25] * 4)  # in the middle of the frame
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("ArrowLeft")
    assert page.locator("[data-time]").text_content() == "1.1 s"
    page.keyboard.press("Space")
    page.wait_for_function(f"{TIMES}.every(time => time > 1.4)")
    page.keyboard.press("Space")
    assert page.locator("[data-play]").text_content() == "▶ Play"


def test_moments_events_slider_and_plots_go_to_their_time(page: Page) -> None:
    moment = page.locator(".moments button").last
    time = float(moment.get_attribute("data-seek") or "nan")
    moment.click()
    assert page.locator("[data-time]").text_content() == f"{time:.1f} s"
    assert page.evaluate(TIMES) == pytest.approx([min(time + 0.05, 1.975)] * 4, abs=0.03)
    page.locator("[data-scrub]").fill("0.5")
    assert page.locator("[data-time]").text_content() == "0.5 s"
    plot = page.locator(".plot .canvas").first
    box = plot.bounding_box()
    assert box is not None
    middle = (56 + 590) / 2 / 600 * box["width"]
    plot.click(position={"x": middle, "y": box["height"] / 2})
    assert page.locator("[data-time]").text_content() == "1.0 s"
    cursor = page.locator(".cursor").first.bounding_box()
    assert cursor is not None and cursor["x"] - box["x"] == pytest.approx(middle, abs=1.5)


def test_plots_can_be_read(page: Page) -> None:
    """At 100 % on a page of 1280 pixels the letters of plots are as large as those of tables."""
    letters = "[...document.querySelectorAll('.plot text')]"
    sizes = page.evaluate(f"{letters}.map(one => one.getBoundingClientRect().height)")
    heights = [size for size in sizes if size > 0]
    assert len(heights) > 40 and min(heights) > 10


def test_one_camera_shows_at_a_time_and_all_is_on_one_screen(
    browser: BrowserContext, page_file: Path, tmp_path: Path
) -> None:
    film, parts = page_file.parents[1] / "native.mp4", []
    for arm, brake in (("native", 0.0), ("replaced", 2.0)):
        rollout = cut_in(arm, steps=STEPS, brake=brake, cut=False)
        films = {"front_left": film, "front": film}
        parts.append(RolloutPart(arm, rollout, rollout_metrics(rollout, straight_map()), films))
    scenario = ScenarioPart("Cut-in", "", tuple(parts))
    run = ReportInputs("Car 0", "log", ARMS, scenarios=(scenario,), camera_headings={"front": 0.0})
    tab = browser.new_page()
    tab.set_viewport_size({"width": 1440, "height": 900})
    tab.goto(write_report(run, tmp_path / "report").as_uri())
    for chosen, hidden in (("front", "front_left"), ("front_left", "front")):
        tab.locator("[data-cameras]").select_option(chosen)
        assert tab.locator(f"[data-camera={chosen}]").first.is_visible()
        assert not tab.locator(f"[data-camera={hidden}]").first.is_visible()
    tab.locator(".player .arms").first.scroll_into_view_if_needed()
    height = "document.querySelector('.player').getBoundingClientRect().height"
    assert tab.evaluate(height) < 850
    tab.close()


def test_the_replay_opens(page: Page) -> None:
    page.get_by_text("Open the moving scene").click()
    page.wait_for_function("document.title === 'the moving scene'")


def test_on_paper_there_are_overview_and_moments_on_two_pages(page: Page, tmp_path: Path) -> None:
    page.emulate_media(media="print")
    assert not page.locator("video").first.is_visible()
    assert not page.locator(".plots").first.is_visible()
    assert page.locator(".moments img").first.is_visible()
    assert page.locator("#overview .checks").is_visible()
    page.pdf(path=tmp_path / "page.pdf", prefer_css_page_size=True)
    document = (tmp_path / "page.pdf").read_bytes()
    assert len(re.findall(rb"/Type\s*/Page\b", document)) == 2


@pytest.mark.skipif(RUN is None, reason="set RECAST_VIEW_RUN to the folder of a demo's run")
def test_the_report_of_a_run_and_the_pictures_of_the_docs(
    browser: BrowserContext, tmp_path: Path
) -> None:
    page_file = report_run(str(RUN), tmp_path / "report")
    page = browser.new_page()
    page.goto(page_file.as_uri())
    page.add_style_tag(content="* { position: static !important }")  # bars lie over the pictures
    picture(page.locator("header").first, "report-first-screen")
    scenario = page.locator("#scenario-1")
    scenario.scroll_into_view_if_needed()
    picture(scenario.locator(".moments"), "report-moments")
    scenario.locator(".moments button").nth(1).click()
    page.wait_for_timeout(500)
    picture(scenario.locator(".player"), "report-player")
    picture(scenario.locator(".plots"), "report-plots")
    page.get_by_text("Open the moving scene").click()
    page.wait_for_url("**/replay.html")
    page.close()


def picture(part: Locator, name: str) -> None:
    """Take a picture for the docs."""
    image = Image.open(BytesIO(part.screenshot())).convert("RGB")
    image.save(DOCS / f"{name}.jpg", quality=85, optimize=True)
