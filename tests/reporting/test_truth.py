from __future__ import annotations

import dataclasses
import hashlib
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.core.files import write_json
from recast.metrics import Agreement, OracleView, OracleViews, rollout_metrics
from recast.metrics.oracle_scores import summarise
from recast.reporting import (
    NotMade,
    ReportInputs,
    RolloutPart,
    ScenarioPart,
    ShowcasePart,
    TruthPart,
    truth_parts,
    write_report,
    write_video,
)
from recast.reporting.finding import FINDING_FILE
from recast.reporting.page import PageAssets
from recast.reporting.report import angle_label, truth_view
from recast.reporting.summary import checks
from reporting.made_up_rollouts import HOSTILE, cut_in, straight_map
from support.report_pages import Page

SIDES = {"baseline": "native", "candidate": "replaced", "truth": "oracle"}
ARMS = {"native": "native actor", "replaced": f"replaced {HOSTILE}", "oracle": "truth (oracle)"}


def made_up_views() -> OracleViews:
    """Ten views; the replaced actor is nearer to the truth beyond 60 degrees only."""
    views = []
    for index, angle in enumerate(np.linspace(5.0, 170.0, 10)):
        native = Agreement(28.0 - angle / 10, 0.9 - angle / 400, 0.95 - angle / 300, 0.5)
        replaced = Agreement(24.0, 0.8, 0.8, 0.6)
        views.append(
            OracleView(
                index,
                "front",
                12,
                1_200_000,
                10.0,
                float(index),
                float(angle - 180),
                5.0,
                float(angle),
                (10, 10, 40, 30),
                native,
                replaced,
            )
        )
    summary = summarise(views, np.random.default_rng(0))
    return OracleViews("7", 80, tuple(views), summary, 9)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("truth")
    views = made_up_views()
    write_json(out / "oracle_views.json", views.to_json())
    names = [view.picture for view in views.views]
    for i, name in enumerate([*names, *(f"showcase_{s}.png" for s in ("baseline", "candidate"))]):
        Image.fromarray(np.full((20, 30, 3), 20 * i, np.uint8)).save(out / name)
    return out  # without showcase_truth.png


@pytest.fixture(scope="module")
def run(folder: Path) -> ReportInputs:
    show, truth = truth_parts(folder, ARMS, **SIDES)
    film = folder / "film.mp4"
    write_video(film, [np.zeros((48, 96, 3), np.uint8)] * 3)
    parts = []
    for arm, brake in (("native", 0.0), ("replaced", 1.4), ("oracle", 1.5)):
        rollout = cut_in(arm, steps=30, brake=brake, cut=False)
        metrics = rollout_metrics(rollout, straight_map())
        parts.append(RolloutPart(arm, rollout, metrics, {"front": film}))
    return ReportInputs(
        "t",
        "log",
        ARMS,
        scenarios=(ScenarioPart("Cut-in", "", tuple(parts)),),
        truth_arm="oracle",
        showcase=show,
        truth=truth,
    )


@pytest.fixture(scope="module")
def report(run: ReportInputs, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(run, tmp_path_factory.mktemp("out") / "report")


def test_the_first_screen_comes_before_everything(report: Path) -> None:
    page = Page(report)
    text = page.text
    pictures = [a["src"] or "" for tag, a in page.tags if tag == "img"]
    assert pictures[:3] == [p for p in pictures if "finding" in p]
    assert len([p for p in pictures if "showcase" in p]) == 2
    for words in (
        "seen three ways",
        "recast completes what",
        "seen from its front, 10 m ahead of the camera and 170° away from the nearest of the 80",
        "PSNR 11.0\u00a0dB, SSIM 0.475, mask IoU 0.38",
        "nearer to the truth",
        "Over all 7 views 60° or more",
        "showcase_truth.png is missing",
    ):
        assert words.replace("\u00a0", " ") in text, words
    assert text.index("Cut-in: with") < text.index("Overview") < text.index("In the log log")


def test_the_section_tells_who_wins_at_which_angle(run: ReportInputs, report: Path) -> None:
    truth = run.truth
    assert isinstance(truth, TruthPart)
    shown = truth_view(truth, PageAssets(report.parent.parent / "again"))
    labels = [line.label for line in shown.lines]
    assert labels == [
        "0° to 30°",
        "30° to 60°",
        "60° to 90°",
        "90° and more",
        "60° and more",
        "all views",
    ]
    near, *_, beyond, _ = shown.lines
    assert [cell.tone for cell in near.cells] == ["good", "plain"] * 3 + ["plain", "good"]
    assert [cell.tone for cell in beyond.cells] == ["plain", "good"] * 4
    assert "better in 7 of 7" in (beyond.cells[5].note or "") and beyond.total
    assert [caption.split("°")[0] for caption, _ in shown.pictures][:2] == ["170", "152"]
    assert len(shown.pictures) == 10
    page = Page(report)
    assert "Against the truth" in page.text and "in 10 views; 7 of these views" in page.text
    assert sum(tag == "svg" for tag, _ in page.tags) == 4 + 2


def test_three_methods_leave_no_loose_ends(report: Path) -> None:
    page = Page(report)
    files = {p.relative_to(report.parent).as_posix() for p in report.parent.rglob("*.*")}
    linked = {link for link in page.links() if not link.startswith("#")}
    assert linked == files - {"index.html", FINDING_FILE}
    ids = [a["id"] for _, a in page.tags if a.get("id")]
    assert len(ids) == len(set(ids))
    raw = report.read_text(encoding="utf-8")
    assert "<script>alert" not in raw and not re.search(r"https?:", raw)
    assert sum("side-by-side" in link for link in linked) == 1
    assert "Distance of the ego from its path with the truth" in page.text


def test_the_checks_ask_for_the_replaced_actor_to_be_nearer(run: ReportInputs) -> None:
    by_name = {check.name: check for check in checks(run)}
    assert by_name["Mask IoU, 60° and more from the log"].tone == "good"
    views = made_up_views()
    worse = tuple(
        dataclasses.replace(v, baseline=v.candidate, candidate=v.baseline) for v in views.views
    )
    summary = summarise(worse, np.random.default_rng(0))
    truth = dataclasses.replace(run.truth, views=dataclasses.replace(views, summary=summary))
    by_name = {check.name: check for check in checks(dataclasses.replace(run, truth=truth))}
    assert by_name["PSNR, 60° and more from the log"].tone == "bad"


def test_same_inputs_same_bytes(run: ReportInputs, report: Path, tmp_path: Path) -> None:
    again = write_report(run, tmp_path / "report")
    assert (
        hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(report.read_bytes()).digest()
    )


def test_without_a_truth_the_page_is_as_before(tmp_path: Path) -> None:
    page = Page(write_report(ReportInputs("t", "log", {"native": "N"}), tmp_path / "a"))
    assert "truth" not in page.text.lower() and "seen three ways" not in page.text
    run = ReportInputs("t", "log", {"native": "N"}, truth=NotMade("the log is a real one"))
    assert "Not made: the log is a real one" in Page(write_report(run, tmp_path / "b")).text


def test_a_showcase_of_one_s_own(tmp_path: Path) -> None:
    grey = np.full((20, 30, 3), 90, np.uint8)
    show = ShowcasePart("The car from behind.", {"before": grey, "after": grey}, purpose="To see.")
    run = ReportInputs("t", "log", {"native": "N"}, showcase=show)
    page = Page(write_report(run, tmp_path / "report"))
    assert "To see." in page.text and "seen two ways" in page.text
    assert "nearer to the truth" not in page.text


def test_an_unknown_truth_is_refused(tmp_path: Path) -> None:
    run = ReportInputs("t", "log", {"native": "N"}, truth_arm="oracle")
    with pytest.raises(ValueError, match="truth_arm: 'oracle'"):
        write_report(run, tmp_path / "report")


def test_methods_that_were_not_driven_have_names_all_the_same(folder: Path) -> None:
    show, truth = truth_parts(folder, {"replaced": "mine"}, **SIDES)
    assert list(show.pictures) == ["street's own actor", "mine", "truth"]
    assert truth.colours == {"baseline": 1, "candidate": 0}


def test_a_truth_alone_is_compared_with_nothing(tmp_path: Path) -> None:
    rollout = cut_in("oracle", steps=10, cut=False)
    part = RolloutPart("oracle", rollout, rollout_metrics(rollout, straight_map()))
    run = ReportInputs(
        "t",
        "log",
        {"oracle": "truth"},
        scenarios=(ScenarioPart("Cut-in", "", (part,)),),
        truth_arm="oracle",
    )
    assert "minus" not in Page(write_report(run, tmp_path / "report")).text.split("What the")[0]


def test_ranges_of_angles_in_words() -> None:
    assert angle_label(0.0, 180.0) == "all views"
    assert angle_label(90.0, 180.0) == "90° and more"
