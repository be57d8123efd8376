"""Making a vehicle set of photographs: a folder for each vehicle, and a table about them.

    PHOTOS/vehicles.csv (or vehicles.json)
    PHOTOS/ID/001.jpg, 002.jpg, ...    in order of azimuth

Vehicles are prepared by one process or several. Beside the set, `.ingest` remembers hashes and
doubts, and ingest.json lists what was left out. See docs/recar.md.
"""

from __future__ import annotations

import multiprocessing
import re
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from recast.core import files
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError
from recast.core.records import Record, validated
from recast.core.workers import worker_pool
from recast.recar.ingest_folder import check_sizes, photographs_of, pick_photographs
from recast.recar.ingest_photograph import (
    WORDS,
    Hashes,
    PhotographCandidate,
    PhotographMasker,
    Prepared,
    SeenPictures,
    perceptual_hash,
    prepare,
)
from recast.recar.ingest_table import LAYOUTS, IngestSettings, VehicleRow, find_table, read_table
from recast.recar.vehicle_set import (
    IDENTITY_FILE,
    Identity,
    IdentityRecord,
    SetRecord,
    VehicleSet,
    begin_set,
    check_begin,
    finish_set,
    read_identities,
    read_set,
    split_of,
    view_file,
)


@dataclass(frozen=True)
class IngestReport:
    """What came of it.

    Attributes:
        skipped: why a vehicle is not in it, by its name.
        doubts: what a person should look at, by identity.
    """

    vehicle_set: VehicleSet
    skipped: dict[str, InputError]
    doubts: dict[str, tuple[str, ...]]


def ingest_photographs(
    photos: str | Path,
    out: str | Path,
    settings: IngestSettings,
    remover: PhotographMasker | None,
    *,
    table: str | Path | None = None,
    skip_bad: bool = False,
    workers: int = 1,
    on_bad: Callable[[str, InputError], None] | None = None,
    progress: Progress | None = None,
) -> IngestReport:
    """Make a vehicle set of a folder with photographs of each vehicle.

    All rows, file names and picture headers are looked at first; without `skip_bad`, nothing is
    written where one is wrong. What turns out later, such as a photograph cut short or the same
    vehicle twice, is listed in the set's ingest.json, and the good vehicles stay. A run that was
    killed, or whose bad vehicles have been mended, goes on with those that are not yet there. The
    files are the same for any number of workers.

    Args:
        out: folder of the set; new, empty, or a set of the same settings.
        remover: background remover for photographs in which nothing is transparent; None refuses
            them.
        table: table as a CSV or JSON file; None finds it beside the folders.
        on_bad: called with the name and the fault of each bad vehicle.

    Raises:
        InputError: bad vehicles where they are not skipped, no good ones, a table that cannot be
            read, `out` holds something else, or the disk is full.
    """
    photos, out = Path(photos), Path(out)
    settings.validate()
    worker_pool(workers)  # refuses less than one
    work = _Ingest(photos, out, settings, on_bad)
    candidates = work.look(Path(table) if table is not None else None)
    total = len(candidates) + len(work.skipped)
    if work.skipped and not skip_bad:
        raise work.refusal(total, "")
    record = settings.record(out.absolute().name, total)
    names = [one.row.id for one in candidates]
    check_begin(out, record, [*names, *work.skipped])
    begin_set(out, record, [*names, *work.skipped])
    with files.alone_in(out):
        left = work.already_there(candidates, record)
        done, total_pictures = len(names) - len(left), len(names) * settings.views
        for candidate, found in prepare_all(left, settings, remover, workers):
            work.take(candidate, found, record)
            done += 1
            tell(progress, done * settings.views, total_pictures)
        write_report(out, work.skipped, work.doubts)
    if work.skipped and not skip_bad:
        raise work.refusal(total, f"; the other {len(work.doubts)} are in {out}")
    if not work.doubts:
        raise work.refusal(total, "")
    finish_set(out, record.model_copy(update={"identities": len(work.doubts)}))
    return IngestReport(read_set(out), work.skipped, work.doubts)


class _Ingest:
    """One run: what was skipped, and the doubts about what was taken."""

    def __init__(
        self,
        photos: Path,
        out: Path,
        settings: IngestSettings,
        on_bad: Callable[[str, InputError], None] | None,
    ) -> None:
        self.photos, self.out, self.settings = photos, out, settings
        self.skipped: dict[str, InputError] = {}
        self.doubts: dict[str, tuple[str, ...]] = {}
        self._on_bad = on_bad
        self._seen = SeenPictures(settings.duplicate_bits)
        self._splits: dict[str, str] = {}

    def look(self, table: Path | None) -> list[PhotographCandidate]:
        """The vehicles whose rows, folders and picture headers are right."""
        if not self.photos.is_dir():
            raise InputError(self.photos, "photographs", "are missing", "check the path")
        table = table or find_table(self.photos)
        rows, bad = read_table(table)
        for name, error in bad.items():
            self.skip(name, error)
        known = {row.folder or row.id for row in rows} | bad.keys()
        for path in sorted(p for p in self.photos.iterdir() if p.is_dir() and p.name[0] != "."):
            if path.name not in known:
                problem = f"has no row for {path.name}"
                self.skip(path.name, InputError(table, "id", problem, "add the row"))
        candidates = []
        for row in rows:
            try:
                candidates.append(self._candidate(row))
            except InputError as error:
                self.skip(row.id, error)
        return candidates

    def _candidate(self, row: VehicleRow) -> PhotographCandidate:
        settings = self.settings
        layout = LAYOUTS[settings.layout]
        if layout is None:
            return PhotographCandidate(row, photographs_of(self.photos, row, settings))
        picked = pick_photographs(self.photos, row, settings.views, settings.azimuth_within, layout)
        check_sizes(picked.photographs, settings)
        return picked

    def already_there(
        self, candidates: list[PhotographCandidate], record: SetRecord
    ) -> list[PhotographCandidate]:
        """Remember the pictures of finished vehicles; the others are left to do."""
        finished = read_identities(self.out, record)
        left = []
        for candidate in candidates:
            identity = finished.get(candidate.row.id)
            if identity is None:
                left.append(candidate)
            elif identity.record != self._record(candidate.row):
                problem = "differs from its row in the table"
                mend = "delete the folder to have it made again"
                raise InputError(identity.folder / IDENTITY_FILE, "record", problem, mend)
        asked = {candidate.row.id for candidate in left}
        for name, identity in finished.items():
            if name not in asked:  # also one whose photographs have gone since
                self._remember(identity)
        return left

    def take(
        self, candidate: PhotographCandidate, found: Prepared | InputError, record: SetRecord
    ) -> None:
        """Write a vehicle, unless it is bad or there already under another name."""
        identity = self._record(candidate.row)
        if isinstance(found, InputError):
            self.skip(identity.id, found)
            return
        doubts = list(found.doubts)
        for other, count in self._seen.matches(found.hashes).items():
            if 2 * count >= record.views:
                splits = {identity.split, self._splits[other]}
                self.skip(
                    identity.id,
                    InputError(
                        candidate.photographs[0].parent,
                        "duplicate",
                        f"{count} of {record.views} photographs are the same as those of {other}"
                        f"{', which is in the other split' if len(splits) == 2 else ''}",
                        "keep one of the two vehicles; if both are right, lower `duplicate_bits`",
                    ),
                )
                return
            doubts.append(f"{count} of {record.views} photographs look like those of {other}")
        write_entry(self.out, identity.id, found.hashes, tuple(doubts))
        with files.atomic_folder(self.out / identity.id) as partial:
            for index, picture in enumerate(found.pictures):
                (partial / view_file(index)).write_bytes(picture)
            files.write_json(partial / IDENTITY_FILE, identity.model_dump(mode="json"))
        self._remember(Identity(self.out / identity.id, identity, record))

    def skip(self, name: str, error: InputError) -> None:
        """List a bad vehicle."""
        self.skipped[name] = error
        if self._on_bad is not None:
            self._on_bad(name, error)

    def refusal(self, total: int, others: str) -> InputError:
        """The one line that ends a run with bad vehicles."""
        name, first = next(iter(self.skipped.items()))
        report = f"all are listed in {self.out / REPORT_FILE}" if others else "all are listed above"
        return InputError(
            self.photos,
            "vehicles",
            f"{len(self.skipped)} of {total} cannot be used, such as {name} "
            f"({first.field}: {first.problem}, in {Path(first.where).name}); {report}{others}",
            "correct them and run again, or leave them out with `skip_bad`",
        )

    def _remember(self, identity: Identity) -> None:
        hashes, doubts = read_entry(self.out, identity)
        name = identity.record.id
        self._seen.add(name, hashes)
        self._splits[name] = identity.record.split
        self.doubts[name] = doubts

    def _record(self, row: VehicleRow) -> IdentityRecord:
        settings = self.settings
        return IdentityRecord(
            id=row.id,
            kind=row.kind,
            category=row.category,
            colour=row.colour,
            size=row.size,
            distance_m=row.distance_m,
            split=row.split or split_of(row.id, settings.split_seed, settings.held_out_share),
            source=row.source,
            licence=row.licence,
        )


def prepare_all(
    candidates: Sequence[PhotographCandidate],
    settings: IngestSettings,
    remover: PhotographMasker | None,
    workers: int,
) -> Iterator[tuple[PhotographCandidate, Prepared | InputError]]:
    """Every vehicle in order, or why it cannot be taken; at most two a worker are in memory."""
    workers = min(workers, max(len(candidates), 1))
    if workers == 1:  # not by the pool, whose workers have one thread: a background network has all
        work = _start(0, settings, remover)
        yield from ((one, work((number, one))) for number, one in enumerate(candidates))
        return
    left, ended, turn = deque(enumerate(candidates)), dict[int, Prepared | InputError](), 0

    def take() -> tuple[int, PhotographCandidate] | None:
        return left.popleft() if left and left[0][0] < turn + 2 * workers else None

    pool = worker_pool(workers)
    for (number, _), found in pool(_start, (settings, remover), take, "finished vehicles"):
        ended[number] = found
        while turn in ended:
            turn += 1
            yield candidates[turn - 1], ended.pop(turn - 1)


def _start(
    _: int, settings: IngestSettings, remover: PhotographMasker | None
) -> Callable[[tuple[int, PhotographCandidate]], Prepared | InputError]:
    if multiprocessing.parent_process() is not None:
        cv2.setNumThreads(1)

    def work(job: tuple[int, PhotographCandidate]) -> Prepared | InputError:
        try:
            return prepare(job[1], settings, remover)
        except InputError as error:
            return error

    return work


REPORT_FILE = "ingest.json"
_FOLDER = ".ingest"  # a reader of the set takes no folder whose name begins with a dot


class _Entry(Record):
    hashes: tuple[str, ...]
    doubts: tuple[str, ...]


def write_entry(out: Path, identity: str, hashes: Hashes, doubts: tuple[str, ...]) -> None:
    """Remember hashes (V, 4) and doubts of an identity."""
    value = {"hashes": [one.tobytes().hex() for one in hashes], "doubts": list(doubts)}
    files.write_json(out / _FOLDER / f"{identity}.json", value)


def read_entry(out: Path, identity: Identity) -> tuple[Hashes, tuple[str, ...]]:
    """Hashes (V, 4) and doubts of a finished identity, the hashes anew where they are lost."""
    path, views = out / _FOLDER / f"{identity.record.id}.json", identity.set_record.views
    try:
        entry = _Entry.model_validate(files.read_json(path))
        data = bytes.fromhex("".join(entry.hashes))
        return np.frombuffer(data, np.uint64).reshape(views, WORDS), entry.doubts
    except ValueError:  # as are those of pydantic, and an InputError
        return np.stack([perceptual_hash(identity.view(index)) for index in range(views)]), ()


def write_report(
    out: Path, skipped: Mapping[str, InputError], doubts: Mapping[str, tuple[str, ...]]
) -> None:
    """Write ingest.json: every vehicle that is not in the set and why, and every doubt."""

    def shown(text: str) -> str:  # settings in backquotes as options of the command line
        return re.sub("`([a-z_]+)`", lambda name: "--" + name[1].replace("_", "-"), text)

    value = {
        "skipped": [
            {
                "vehicle": name,
                "where": shown(error.where),
                "field": shown(error.field),
                "problem": error.problem,
                "mend": shown(error.mend),
            }
            for name, error in sorted(skipped.items())
        ],
        "doubts": {name: list(lines) for name, lines in sorted(doubts.items()) if lines},
    }
    files.write_json(out / REPORT_FILE, value)


class _Report(Record):
    skipped: tuple[dict[str, str], ...]
    doubts: dict[str, tuple[str, ...]]


def read_doubts(out: Path) -> dict[str, tuple[str, ...]] | None:
    """The doubts in ingest.json by identity; None for a set without the file, such as renders.

    Raises:
        InputError: the file is broken.
    """
    path = out / REPORT_FILE
    if not path.exists():
        return None
    mend = "run `recast recar ingest` again, or delete the file"
    return validated(path, files.read_json(path), _Report, mend).doubts
