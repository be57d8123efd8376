"""What all pages share: templates, files under safe names, and the folder that appears whole."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image as PilImage

from recast import __version__
from recast.core import files
from recast.core.errors import InputError
from recast.core.files import atomic_folder, disk_errors, write_text
from recast.core.images import decode_image, eight_bits, opened
from recast.reporting import drawing, tables
from recast.reporting.inputs import NotMade, Picture
from recast.reporting.summary import coverage_note, trust_figure
from recast.reporting.video import iterate_video, side_by_side, write_video

_QUALITY = 92  # of JPEG; with full colour resolution, about 40 dB on rendered images
_FORMATS = {"PNG": ".png", "JPEG": ".jpg"}
_GENERATOR = "recast report"


@dataclass(frozen=True)
class Media:
    """A file of the report: its address relative to the page, and its size in pixels."""

    url: str
    width: int
    height: int


class PageAssets:
    """Collects the files of one report folder.

    A picture or film that is missing or broken becomes a `NotMade` that says so: a report of an
    incomplete run is still a report.
    """

    def __init__(self, folder: Path, scope: str = "") -> None:
        self.folder, self._scope = folder, scope
        self._taken: set[str] = set()

    def scoped(self, name: str) -> PageAssets:
        """Assets of a part of the page, whose files cannot have the names of another part's."""
        return PageAssets(self.folder, self._free("scopes", name) + "--")  # no slug has two hyphens

    def picture(self, name: str, picture: Picture | NotMade) -> Media | NotMade:
        """Copy a PNG or JPEG, or encode an array as PNG."""
        if isinstance(picture, NotMade):
            return picture
        if isinstance(picture, np.ndarray):
            target = self._target("images", name, ".png")
            _write(target, picture, format="PNG", optimize=False)
            return Media(self._url(target), picture.shape[1], picture.shape[0])
        if not picture.is_file():
            return NotMade(f"{picture.name} is missing")
        try:
            with opened(picture, picture, tuple(_FORMATS)) as image:
                width, height = image.size
                suffix = _FORMATS[image.format]
        except InputError:
            return NotMade(f"{picture.name} is not a PNG or JPEG")
        target = self._target("images", name, suffix)
        shutil.copyfile(picture, target)
        return Media(self._url(target), width, height)

    def photo(self, name: str, picture: Picture | NotMade) -> Media | NotMade:
        """Write a picture as JPEG: a third of a PNG's size, and no difference to the eye.

        One with transparency stays a PNG.
        """
        if isinstance(picture, Path) and picture.is_file():
            try:
                levels = decode_image(picture, picture, ("PNG",))
                if levels.shape[2:] == (3,):
                    picture = eight_bits(levels)
            except InputError:
                pass  # `picture` says what is wrong with it, or copies the JPEG that it is
        if not isinstance(picture, np.ndarray) or picture.shape[2] != 3:
            return self.picture(name, picture)
        target = self._target("images", name, ".jpg")
        _write(target, picture, format="JPEG", quality=_QUALITY, subsampling=0, optimize=True)
        return Media(self._url(target), picture.shape[1], picture.shape[0])

    def film(self, name: str, film: Path | NotMade) -> Media | NotMade:
        """Copy an MP4 whose first frame can be decoded."""
        if isinstance(film, NotMade):
            return film
        if not film.is_file():
            return NotMade(f"{film.name} is missing")
        try:
            height, width, _ = next(iterate_video(film)).shape
        except (InputError, StopIteration):
            return NotMade(f"{film.name} cannot be decoded")
        target = self._target("films", name, ".mp4")
        shutil.copyfile(film, target)
        return Media(self._url(target), width, height)

    def page(self, name: str, page: Path) -> str | NotMade:
        """Copy a page that needs no other file, beside this one; return its address."""
        if not page.is_file():
            return NotMade(f"{page.name} is missing")
        target = self.folder / f"{slug(name)}.html"
        shutil.copyfile(page, target)
        return self._url(target)

    def draw_film(
        self, name: str, frames: Iterable[NDArray[np.uint8]], fps: float, pool: Executor
    ) -> Future[Media]:
        """Draw and encode frames (H, W, 3) uint8 RGB of even size, in a thread of `pool`."""
        target = self._target("films", name, ".mp4")  # here, so that names depend on no thread

        def encode() -> Media:
            write_video(target, frames, fps)
            return self._film(target)

        return pool.submit(encode)

    def joined_film(
        self, name: str, films: Sequence[tuple[str, Media]], pool: Executor
    ) -> Future[Media | NotMade]:
        """Join labelled films of this report, to show elsewhere, in a thread of `pool`."""
        target = self._target("films", name, ".mp4")

        def join() -> Media | NotMade:
            try:
                places = [self.folder / film.url for _, film in films]
                side_by_side(places, target, [label for label, _ in films])
            except InputError as error:
                if isinstance(error.__cause__, OSError):  # the disk refuses, which ends the report
                    raise
                return NotMade(f"{error.field} {error.problem}")
            return self._film(target)

        return pool.submit(join)

    def _film(self, path: Path) -> Media:
        height, width, _ = next(iterate_video(path)).shape
        return Media(self._url(path), width, height)

    def _target(self, kind: str, name: str, suffix: str) -> Path:
        path = self.folder / kind / f"{self._scope}{self._free(kind, name)}{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def _free(self, kind: str, name: str) -> str:
        stem, number = slug(name), 2
        while f"{kind}/{stem}" in self._taken:
            stem, number = f"{slug(name)}-{number}", number + 1
        self._taken.add(f"{kind}/{stem}")
        return stem

    def _url(self, path: Path) -> str:
        return path.relative_to(self.folder).as_posix()


def slug(text: str) -> str:
    """Lower-case letters, digits and single hyphens; safe as a file name and in a URL."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:80] or "unnamed"


def _write(path: Path, picture: NDArray[np.uint8], **options: object) -> None:
    """Encode an array; Pillow itself writes JPEG past a full disk without a word."""
    encoded = BytesIO()
    PilImage.fromarray(picture).save(encoded, **options)  # type: ignore[arg-type]
    files.write_bytes(path, encoded.getvalue())


def write_page(out: str | Path, render: Callable[[PageAssets], str]) -> Path:
    """Write a folder with a page and its files; return its `index.html`.

    The folder appears whole; an earlier one at `out` is replaced. `render` makes the page, and the
    files that it shows.

    Raises:
        InputError: `out` holds something that is no report, or the disk is full.
    """
    out = Path(out)
    check_out(out)
    fresh = out.with_name(f".{out.name}.fresh")
    with disk_errors(out):
        if fresh.exists():  # left behind by a kill
            shutil.rmtree(fresh)
    with atomic_folder(fresh) as folder:
        write_text(folder / "index.html", render(PageAssets(folder)))
    with disk_errors(out):
        if out.exists():
            shutil.rmtree(out)
        fresh.rename(out)
    return out / "index.html"


def check_out(out: Path) -> None:
    """Refuse (InputError) a folder that is neither empty nor a report."""
    if out.exists() and not _is_report(out):
        raise InputError(
            out,
            "report folder",
            "contains files that are not part of a report",
            "choose another folder",
        )


def render_template(name: str, **values: object) -> str:
    """Fill in a template; all values from outside are escaped."""
    environment = Environment(
        loader=PackageLoader("recast.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.tests["missing"] = lambda value: isinstance(value, NotMade)
    environment.filters["arm_colour"] = lambda i: drawing.css(drawing.arm_colour(i))
    environment.filters["coverage_note"] = coverage_note
    environment.filters["trust_figure"] = trust_figure
    loader = environment.loader
    assert loader is not None

    def inline(file: str) -> Markup:
        return Markup(loader.get_source(environment, file)[0])

    environment.globals.update(
        share_colours={name: drawing.css(colour) for name, colour in drawing.SHARES.items()},
        zip=zip,
        markup=Markup,
        inline=inline,
        generator=f"{_GENERATOR} {__version__}",
        headings=values.get("headings") or tables.headings(),
    )
    return environment.get_template(name).render(values)


def _is_report(folder: Path) -> bool:
    page = folder / "index.html"
    if not page.is_file():
        return folder.is_dir() and not any(folder.iterdir())
    return f'content="{_GENERATOR}' in page.read_text(encoding="utf-8", errors="replace")[:2000]
