"""Time and memory of vehicle sets as they grow, up to the paper's 20,000 vehicles x 30 pictures.

    python benchmarks/vehicle_sets.py                                 # 400 vehicles, about a minute
    python benchmarks/vehicle_sets.py --vehicles 20000 --width 60     # the paper's count, 2 GB
    python benchmarks/vehicle_sets.py --vehicles 20000 --screen 200 --template SET   # and its sizes

The pictures are those of a few rendered vehicles (or of `--template`), hard-linked, so that a set
has its files and their sizes but takes no room. `--screen` bounds the vehicles that are screened.
Every step runs in a process of its own, at a quarter of the vehicles and at all: "growth" is the
time a vehicle at all over that at a quarter, 1 where the step is linear. Seconds are CPU seconds of
one thread; MiB is what the step took at most, beside what importing takes (Linux). Everything read
lies in the page cache. All that is written is removed again.
"""

from __future__ import annotations

import argparse
import errno
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from recast.recar import (
    SynthesisSettings,
    VehicleSet,
    read_set,
    set_statistics,
    split_of,
    synthesize_set,
)
from recast.recar.ingest import ingest_photographs
from recast.recar.ingest_photograph import Hashes, SeenPictures, perceptual_hash
from recast.recar.ingest_table import BITS, IngestSettings
from recast.recar.screening import screened_vehicles, write_screening
from recast.recar.synthesis import plan_identities
from recast.recar.vehicle_set import view_file

KINDS = ("sedan", "suv", "hatchback", "van", "pickup")
FLIPPED = 0.3
"""Chance of each bit of a made-up hash: two then differ in 107 bits, the median of renders of
different synthetic vehicles from the same side (60 vehicles, 6 views)."""


@dataclass(frozen=True)
class Measured:
    """One step: CPU seconds, MiB that it took at most, and what it says of itself."""

    seconds: float
    memory: float
    detail: str


def measured(step: Callable[..., str], *arguments: object) -> Measured:
    """Run a step in a fresh process."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(_measure, step, arguments).result()


def _measure(step: Callable[..., str], arguments: tuple[object, ...]) -> Measured:
    Path("/proc/self/clear_refs").write_text("5")  # forget the peak that importing took
    before, start = memory("VmRSS"), time.process_time()
    detail = step(*arguments)
    return Measured(time.process_time() - start, memory("VmHWM") - before, detail)


def memory(what: str) -> float:
    """MiB of this process that Linux lists under a name."""
    (line,) = (x for x in Path("/proc/self/status").read_text().splitlines() if what in x)
    return int(line.split()[1]) / 1024


def write_linked(template: VehicleSet, folder: Path, vehicles: int) -> Path:
    """A set whose pictures are hard links to those of a few vehicles."""
    sources = list(template.identities.values())
    files = [view_file(index) for index in range(template.record.views)]
    pictures = {one.record.id: one.folder for one in sources}
    folder.mkdir()
    for index in range(vehicles):
        source = sources[index % len(sources)].record
        id = f"car-{index:06d}"
        made = folder / id
        made.mkdir()
        split = split_of(id, 0)
        changes = {"id": id, "split": split, "kind": KINDS[index % len(KINDS)]}
        (made / "identity.json").write_text(json.dumps(source.model_dump(mode="json") | changes))
        for file in files:
            try:
                os.link(pictures[source.id] / file, made / file)
            except OSError as error:
                if error.errno != errno.EMLINK:  # a file system bounds the links of a file
                    raise
                copies = folder.parent / f"copy-{folder.name}-{id}"
                shutil.copytree(pictures[source.id], copies)
                pictures[source.id] = copies
                os.link(copies / file, made / file)
    record = template.record.model_copy(update={"identities": vehicles})
    (folder / "set.json").write_text(json.dumps(record.model_dump(mode="json")))
    return folder


def open_folders(folder: Path) -> str:
    found = read_set(folder)
    held_out = sum(1 for _ in found.of_split("held-out"))
    return f"{held_out} held out, {100 * held_out / len(found.identities):.2f} %"


def check_headers(folder: Path) -> str:
    found = read_set(folder)
    found.check_pictures()
    return f"{len(found.identities) * found.record.views:,} headers"


def count(folder: Path) -> str:
    found = set_statistics(read_set(folder))
    return f"{found.bytes / 1e9:.2f} GB of pictures"


def plan_synthesis(vehicles: int) -> str:
    return f"{len(plan_identities(SynthesisSettings(), vehicles, 0, []))} identities"


def made_up(base: Hashes, rng: np.random.Generator) -> Hashes:
    """Hashes of a vehicle that is in the set under no other name."""
    flips = rng.random((len(base), BITS + 1)) < FLIPPED
    flips[:, BITS] = False
    return np.asarray(base ^ np.packbits(flips, axis=1).view(np.uint64))


def find_duplicates(base: Hashes, vehicles: int) -> str:
    rng = np.random.default_rng(0)
    seen = SeenPictures()
    for index in range(vehicles):
        hashes = made_up(base, rng)
        seen.matches(hashes)
        seen.add(str(index), hashes)
    asked = [made_up(base, rng) for _ in range(10)]

    start = time.process_time()
    for hashes in asked:
        seen.matches(hashes)
    return f"{100 * (time.process_time() - start):.1f} ms a vehicle at the end"


def screen(folder: Path) -> str:
    found = read_set(folder)
    start = time.process_time()
    made = write_screening(folder, found.identities, screened_vehicles(found))
    seconds = time.process_time() - start
    return f"{made.vehicles / seconds:.1f} vehicles/s, {made.sheets} sheets"


def ingest(photos: Path, out: Path, views: int, width: int, height: int) -> str:
    settings = IngestSettings("CC0-1.0", views=views, width=width, height=height, duplicate_bits=0)
    start = time.process_time()
    made = ingest_photographs(photos, out, settings, None).vehicle_set
    pictures = len(made.identities) * views
    seconds = time.process_time() - start
    return f"{pictures / seconds:.1f} pictures/s from PNG with alpha"


def template_of(arguments: argparse.Namespace, folder: Path) -> VehicleSet:
    if arguments.template:
        return read_set(arguments.template)
    height = max(round(arguments.width * 2 / 3), 16)
    settings = SynthesisSettings(views=arguments.views, width=arguments.width, height=height)
    return synthesize_set(folder / "template", 2, settings)


def run(arguments: argparse.Namespace, folder: Path) -> None:
    """Measure every step and print a line of each."""
    template = template_of(arguments, folder)
    record, all_vehicles = template.record, arguments.vehicles
    sizes = (max(all_vehicles // 4, 2), all_vehicles)
    first = next(iter(template.identities.values()))
    base = np.stack([perceptual_hash(first.view(index)) for index in range(record.views)])
    sets = [write_linked(template, folder / f"set-{number}", number) for number in sizes]
    most = min(arguments.screen or all_vehicles, all_vehicles)
    screened_sizes = [max(most // 4, 2), most]
    linked = dict(zip(sizes, sets, strict=True))
    screened = [
        linked.get(number) or write_linked(template, folder / f"some-{number}", number)
        for number in screened_sizes
    ]
    print(f"{record.views} pictures of {record.width}x{record.height} a vehicle; CPU seconds")
    line = "{:22} {:>8} {:>8} {:>8} {:>7} {:>8} {:>8}  {}"
    print(line.format("step", "vehicles", "s", "vehicles", "s", "growth", "MiB", ""))

    def show(name: str, step: Callable[..., str], counts: list[int], *given: list[object]) -> None:
        found = [measured(step, *(one[place] for one in given)) for place in range(2)]
        rates = [one.seconds / number for one, number in zip(found, counts, strict=True)]
        print(
            line.format(
                name,
                counts[0],
                f"{found[0].seconds:.2f}",
                counts[1],
                f"{found[1].seconds:.2f}",
                f"{rates[1] / rates[0]:.2f}" if counts[1] > counts[0] else "-",
                f"{found[1].memory:.0f}",
                found[1].detail,
            ),
            flush=True,
        )

    whole = list(sizes)
    show("open", open_folders, whole, [*sets])
    show("open, check headers", check_headers, whole, [*sets])
    show("open, statistics", count, whole, [*sets])
    show("plan synthesis", plan_synthesis, whole, [*sizes])
    show("find duplicates", find_duplicates, whole, [base, base], [*sizes])
    show("screen", screen, screened_sizes, [*screened])
    photos = folder / "photos"
    for number, (id, one) in enumerate(template.identities.items()):
        shutil.copytree(one.folder, photos / id, ignore=shutil.ignore_patterns("*.json"))
        row = f"{'' if number else 'id,kind' + chr(10)}{id},car\n"
        with (photos / "vehicles.csv").open("a") as table:
            table.write(row)
    one_set = [photos, photos], [folder / "ingest-0", folder / "ingest-1"]
    shape = [[value, value] for value in (record.views, record.width, record.height)]
    show("ingest", ingest, [len(template.identities)] * 2, *map(list, one_set), *shape)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--vehicles", type=int, default=400)
    parser.add_argument("--views", type=int, default=30)
    parser.add_argument("--width", type=int, default=120, help="of rendered pictures, pixels")
    parser.add_argument("--template", type=Path, help="set whose pictures are linked; not changed")
    parser.add_argument("--screen", type=int, help="screen only so many vehicles")
    parser.add_argument("--folder", type=Path, help="where to work; on the template's file system")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        run(arguments, Path(folder))


if __name__ == "__main__":
    main()
