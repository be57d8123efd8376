from __future__ import annotations

import re
import signal
import threading
import time
import urllib.request
from pathlib import Path

import pytest

from recast.cli.recar_sets import Screen
from recast.core.errors import InputError
from recast.recar.screening import Screening

from .screenings import write_cache
from .sets import write_set


def test_the_command_serves_until_it_is_interrupted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], request: pytest.FixtureRequest
) -> None:
    # A shell starts background jobs with the interrupt ignored, and the tests may be one.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    folder = write_cache(tmp_path / "cache").folder
    write_set(tmp_path / "set")
    Screening(folder).decide("car-0", "reject")
    seen: list[bytes] = []

    def look_and_interrupt() -> None:
        printed = ""
        while not (found := re.search(r"http://\S+", printed)):
            time.sleep(0.02)
            printed += capsys.readouterr().out
        with urllib.request.urlopen(found.group() + "picture/car-0/front") as response:
            seen.append(response.read())
        signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=look_and_interrupt, daemon=True)
    thread.start()
    Screen(folder, set=tmp_path / "set", port=0)()
    thread.join()
    assert seen[0].startswith(b"\x89PNG")
    assert "1 of 4 decided, 0 accepted, 1 rejected" in " ".join(capsys.readouterr().out.split())


def test_no_cache_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is missing"):
        Screen(tmp_path / "cache", port=0)()
