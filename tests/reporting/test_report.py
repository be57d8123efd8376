from __future__ import annotations

import dataclasses
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.core.errors import InputError
from recast.metrics.plan_agreement import (
    AgreementMoment,
    PlanAgreement,
    PlanDifference,
    write_agreement,
)
from recast.reporting import (
    ActorPart,
    Comparison,
    NotMade,
    ObservationPart,
    ReportInputs,
    RolloutPart,
    ScenarioPart,
    ScenePart,
    read_video,
    write_report,
)
from recast.reporting.finding import FINDING_FILE
from recast.reporting.summary import checks
from reporting.made_up_rollouts import STEPS
from support.report_pages import Page, digests


def test_every_part_is_on_the_page(report: Path) -> None:
    page = Page(report / "index.html")
    for words in (
        "Can it be trusted?",
        "How each rollout ended",
        "Results over all rollouts",
        "Input crop",
        "Turntable of the actor",
        "Registration to the LiDAR",
        "0.310 m before",
        "0.182 m after",
        "Sides that the LiDAR saw",
        "from two views",
        "Candidates",
        "✓ chosen",
        "93%",
        "Refinement by all images",
        "left out 3",
        "Invented share of the visible actor 25%",
        "What the rollouts showed of the actor",
        "From all around",
        "25% was invented, 25% mirrored and 50% seen in the log (visible in 1 of 2 images).",
        "contact at 2.3 s",
        "0.72. As 7 of 10 like it",
        "trust 0.72",
        "Trust in the verdicts 0.72 near 1; see Rollouts. The calibration is provisional",
        "Street that no image shows, at most 4.0% (1.0% empty), 2.5 s after the start",
        "bird's-eye view",
        "Time to collision of each plan",
        "21.93 dB",
        "LiDAR depth",
        "0.061 m",
        "Video with all arms side by side",
        "Resolved configuration",
        '"steps": 3000',
        "torch",
        "2.13.0",
        "9c1f0a7e",
        "312.4 s",
        "The map was derived.",
        "the rollout failed",
        "the recorded road ends",
        "Drivable-area compliance",
    ):
        assert words in page.text, words
    assert sum(tag == "svg" for tag, _ in page.tags) == 4 + 1  # curves, and what was shown
    films = [a for tag, a in page.tags if tag == "video"]
    assert len(films) == 1 + 2 + 2  # turntable, a camera and a bird's-eye view an arm


def test_the_folder_is_self_contained(report: Path) -> None:
    page = Page(report / "index.html")
    files = set(digests(report)) - {"index.html", FINDING_FILE}  # the latter is for scripts
    linked = {link for link in page.links() if not link.startswith("#")}
    assert linked == files
    ids = {a["id"] for _, a in page.tags if a.get("id")}
    assert {link[1:] for link in page.links() if link.startswith("#")} <= ids
    text = (report / "index.html").read_text(encoding="utf-8")
    assert not re.search(r"https?:|@import|//[a-z0-9.-]+\.[a-z]{2,}/", text)
    assert all(re.fullmatch(r"[a-z0-9/-]+\.(png|jpg|mp4)", name) for name in files)


def test_hostile_names_stay_text(report: Path) -> None:
    page = Page(report / "index.html")
    assert sum(tag == "script" for tag, _ in page.tags) == 1
    raw = (report / "index.html").read_text(encoding="utf-8")
    assert "<script>alert" not in raw
    assert raw.count("&lt;script&gt;alert") > 15
    assert not any(name.startswith("on") for _, a in page.tags for name in a)


def test_pictures_and_films_have_words_for_them(report: Path) -> None:
    page = Page(report / "index.html")
    assert all(a.get("alt") for tag, a in page.tags if tag == "img")
    assert all(a.get("aria-label") for tag, a in page.tags if tag == "video")
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))


def test_films_have_a_frame_for_each_state(report: Path) -> None:
    [film] = report.glob("films/*native-birdseye.mp4")
    frames, fps = read_video(film)
    assert len(frames) == STEPS + 1 and fps == 10.0
    [joined] = report.glob("films/*side-by-side.mp4")
    assert read_video(joined)[0].shape[2] == 96 + 4 + 96


def test_same_inputs_same_bytes_and_the_old_report_is_replaced(
    complete: ReportInputs, report: Path, tmp_path: Path
) -> None:
    (tmp_path / "report").mkdir()  # an empty folder may be used
    write_report(dataclasses.replace(complete, scenarios=()), tmp_path / "report")
    write_report(complete, tmp_path / "report")
    assert digests(tmp_path / "report") == digests(report)
    assert [p.name for p in tmp_path.iterdir()] == ["report"]


def test_a_folder_with_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="not part of a report"):
        write_report(ReportInputs("t", "log", {"native": "Native"}), tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_missing_parts_say_so_with_the_reason(tmp_path: Path) -> None:
    (tmp_path / "broken.mp4").write_text("no film")
    (tmp_path / "broken.png").write_text("no picture")
    run = ReportInputs(
        "t",
        "log",
        {"native": "Native", "recast": "Replaced"},
        actor=ActorPart(
            "track 0",
            "template",
            ObservationPart(tmp_path / "gone.png", NotMade("the camera is blind")),
            turntable=tmp_path / "broken.mp4",
            registration=NotMade("only 12 LiDAR points"),
        ),
        scenarios=(
            ScenarioPart("Cut-in", "", (RolloutPart("native", NotMade("killed at step 7")),)),
        ),
        scene=ScenePart((), (Comparison("frame 3", {"recorded": tmp_path / "broken.png"}),)),
        config=NotMade("an older run"),
    )
    page = Page(write_report(run, tmp_path / "report"))
    for reason in (
        "gone.png is missing",
        "the camera is blind",
        "broken.mp4 cannot be decoded",
        "only 12 LiDAR points",
        "killed at step 7",
        "broken.png is not a PNG or JPEG",
        "an older run",
        "no rollout to plot",
        "no rollout was scored",
        "not driven",
    ):
        assert reason in page.text, reason
    assert digests(tmp_path / "report").keys() == {"index.html"}


def test_a_report_of_nothing_is_a_report(tmp_path: Path) -> None:
    page = Page(write_report(ReportInputs("Empty", "log", {"native": "Native"}), tmp_path / "r"))
    assert page.text.count("Not made:") >= 7
    assert "No rollouts were made." in page.text


def test_an_unknown_method_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    part = RolloutPart("other", NotMade())
    run = ReportInputs("t", "log", {"native": "N"}, scenarios=(ScenarioPart("s", "", (part,)),))
    with pytest.raises(ValueError, match=r"rollouts\[0\]\.arm: 'other'"):
        write_report(run, tmp_path / "report")
    assert not (tmp_path / "report").exists()


def test_plans_against_the_recording(tmp_path: Path) -> None:
    apart = {"native": 0.4, "replaced": 2.5, "one pixel": 0.3}
    moments = tuple(
        AgreementMoment(
            time_us,
            8.0,
            "free",
            time_us == 600_000,
            False,
            {"native": 28.0, "replaced": 27.5},
            {k: PlanDifference(fde / 2, fde, fde > 2) for k, fde in apart.items()},
        )
        for time_us in (100_000, 600_000)
    )
    found = PlanAgreement("gtrs-<mini>", "drive", ("native", "replaced"), moments, left_out=1)
    image = np.full((40, 60, 3), 90, np.uint8)
    pictures = {
        one.timestamp_us: {"recorded": image, "native": image, "replaced": image} for one in moments
    }
    write_agreement(found, pictures, tmp_path / "plans")
    run = ReportInputs("t", "l", {"native": "n"}, recording=(tmp_path / "plans",))
    page = Page(write_report(run, tmp_path / "out"))
    assert "Against the recording" in page.text
    assert (
        "the plans of gtrs-<mini> on rendered images end more than 2 m from those on the recorded "
        "ones in: 0% native, 100% replaced. A shift of the recorded images by one pixel moves 0%. "
        "1 moments without all images were left out."
    ) in page.text
    assert (
        "Plans more than 2 m off those on the recorded images, gtrs-<mini> native 0%, replaced "
        "100%; shifted by one pixel 0%"
    ) in page.text
    (check,) = [one for one in checks(run) if "recorded images" in one.name]
    assert check.tone == "warn"
    alike = dataclasses.replace(run, recording=(tmp_path / "alike",))
    write_agreement(dataclasses.replace(found, arms=("native",)), pictures, tmp_path / "alike")
    (check,) = [one for one in checks(alike) if "recorded images" in one.name]
    assert check.tone == "good"
    assert "native, held out" in page.text and "0.5 s, 8.0 m/s, free: native 0.4 m" in page.text
    shown = [a["src"] or "" for tag, a in page.tags if tag == "img"]
    assert len(shown) == 6
    without = Page(write_report(ReportInputs("t", "l", {"native": "n"}), tmp_path / "b"))
    assert "Against the recording" not in without.text


def test_files_are_copied_as_they_are(tmp_path: Path) -> None:
    Image.fromarray(np.full((4, 6, 3), 90, np.uint8)).save(tmp_path / "crop.png")
    run = ReportInputs(
        "t",
        "log",
        {"native": "N"},
        actor=ActorPart("0", "template", ObservationPart(tmp_path / "crop.png")),
    )
    folder = write_report(run, tmp_path / "report").parent
    copied = (folder / "images/actor-crop.png").read_bytes()
    assert copied == (tmp_path / "crop.png").read_bytes()
