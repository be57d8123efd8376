"""Faults of pictures from driving logs, put on clean conditioning pictures (paper, Stage II).

Drawn by a configuration, put one on the other, and shown on a sheet.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import cv2
import numpy as np
from pydantic import AfterValidator, Field, model_validator

from recast.arrays import Image
from recast.core import files
from recast.core.errors import InputError
from recast.core.images import draw_text
from recast.core.records import Record, read_record
from recast.logs.images import encode
from recast.recar.perturb_camera import (
    Compression,
    Defocus,
    Fog,
    LowLight,
    MotionBlur,
    PerturbationKind,
    Resampling,
    Share,
    find_object,
    premultiplied,
    shrinking,
    straight,
)
from recast.recar.perturb_outline import (
    Border,
    Cropping,
    Dilation,
    Erosion,
    Holes,
    Jagged,
    Leak,
    OtherVehicle,
    Pole,
)
from recast.trellis import check_crop, crop_to_object
from recast.trellis.conditioning import OPAQUE

PERTURBATIONS_FORMAT = "recast-perturbations"
PERTURBATIONS_VERSION = 1
_TRIES = 16
_ROOM = 0.25
"""Kept on each side of the object, over the extent: no kind makes it larger by more."""
SEVERITIES = (0.0, 0.25, 0.5, 0.75, 1.0)
_DRAWS = 10
_MARGIN = 0.12  # around the object, over its extent
_CELL = 200  # pixels of a cell's longer side
_PANEL = np.array((0.87, 0.88, 0.90), np.float32)  # what is transparent shows this
_INK, _MUTED = (31, 36, 48), (107, 114, 128)
_LABEL, _HEAD, _GAP, _SPACE = 110, 66, 26, 4


def _at_least_one(interval: tuple[int, int]) -> tuple[int, int]:
    if not 1 <= interval[0] <= interval[1]:
        raise ValueError("expected two numbers of at least 1, the larger one last")
    return interval


class PerturbationConfig(Record):
    """How conditioning pictures are perturbed in Stage II.

    The default weights make the paper's eight groups equally likely: down-up sampling, blur,
    compression, low light, fog, occlusion, cropping, and mask errors. Kinds are listed, and
    applied, in the order in which a picture comes about: the scene, the air, the lens, the sensor,
    the recorder, the segmenter.

    Attributes:
        rho_clean: chance that a picture stays as it is (paper, Stage II: 0.2).
        composed: fewest and most kinds on one picture, drawn uniformly.
        least_visible: share of the object's opaque area that must be left; draws that leave less
            are drawn again.
        finest: longest extent, in pixels, of a spoilt object; larger ones are brought down to it,
            which is finer than what a crop of 518 pixels shows and spares most of the time.
    """

    format: Literal["recast-perturbations"] = "recast-perturbations"
    version: Literal[1] = 1
    rho_clean: Share = 0.2
    composed: Annotated[tuple[int, int], AfterValidator(_at_least_one)] = (1, 3)
    least_visible: Share = 0.3
    finest: Annotated[float, Field(ge=64, allow_inf_nan=False)] = 448.0
    other_vehicle: OtherVehicle = OtherVehicle()
    pole: Pole = Pole()
    border: Border = Border()
    cropping: Cropping = Cropping()
    fog: Fog = Fog()
    motion_blur: MotionBlur = MotionBlur()
    defocus: Defocus = Defocus()
    low_light: LowLight = LowLight()
    resampling: Resampling = Resampling()
    compression: Compression = Compression()
    erosion: Erosion = Erosion()
    dilation: Dilation = Dilation()
    holes: Holes = Holes()
    leak: Leak = Leak()
    jagged: Jagged = Jagged()

    def kinds(self) -> tuple[PerturbationKind, ...]:
        """All kinds, switched off ones included, in the order in which they are applied."""
        members = (getattr(self, name) for name in type(self).model_fields)
        return tuple(member for member in members if isinstance(member, PerturbationKind))

    @model_validator(mode="after")
    def _something_to_draw(self) -> Self:
        if self.rho_clean < 1 and not any(kind.weight > 0 for kind in self.kinds()):
            raise ValueError("all kinds have weight 0: give one a weight, or set rho_clean to 1")
        return self


def read_perturbations(path: str | Path) -> PerturbationConfig:
    """Read what `write_perturbations` wrote, or a part of it: what is absent has its default.

    Raises:
        InputError: missing, no JSON, another format or version, or a wrong member.
    """
    return read_record(
        path,
        PerturbationConfig,
        PERTURBATIONS_VERSION,
        "correct it, or start from `recast recar perturb --write-config FILE`",
        PERTURBATIONS_FORMAT,
    )


def write_perturbations(path: str | Path, config: PerturbationConfig) -> None:
    """Write a configuration as JSON, every figure of it."""
    files.write_json(path, config.model_dump(mode="json"))


@dataclass(frozen=True)
class Perturbed:
    """A picture and what was done to it.

    Attributes:
        rgba: (H', W', 4) uint8, straight alpha: the picture that was given where it stays clean,
            else the object's surroundings.
        applied: names and severities in the order of application; empty for a clean picture.
    """

    rgba: Image
    applied: tuple[tuple[str, float], ...]


def perturb(rgba: Image, config: PerturbationConfig, rng: np.random.Generator) -> Perturbed:
    """Leave a picture clean with probability rho_clean, or spoil it by one to three kinds.

    A spoilt picture is cut to the object's surroundings, and brought down to `finest` pixels of
    extent where it is larger. A draw whose result `check_crop` refuses, or that hides too much, is
    drawn again; after 16 of them the picture stays clean.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.

    Raises:
        InputError: `rgba` itself is refused by `recast.trellis.check_crop`.
    """
    check_crop(rgba, "image to perturb")
    if rng.uniform() < config.rho_clean:
        return Perturbed(rgba, ())
    window = surroundings(rgba, config.finest)
    for _ in range(_TRIES):
        drawn = draw(config, rng)
        spoilt = compose(window, drawn, rng)
        if spoilt is None or _opaque(spoilt) < config.least_visible * _opaque(window):
            continue
        if _passes(spoilt):
            return Perturbed(spoilt, tuple((kind.name, severity) for kind, severity in drawn))
    return Perturbed(rgba, ())


def draw(
    config: PerturbationConfig, rng: np.random.Generator
) -> tuple[tuple[PerturbationKind, float], ...]:
    """Different kinds and their severities, in the order in which a picture comes about."""
    kinds = [kind for kind in config.kinds() if kind.weight > 0]
    weights = np.array([kind.weight for kind in kinds])
    low, high = config.composed
    count = min(int(rng.integers(low, high + 1)), len(kinds))
    chosen = np.sort(rng.choice(len(kinds), count, replace=False, p=weights / weights.sum()))
    return tuple((kinds[i], float(rng.uniform(*kinds[i].severity))) for i in chosen)


def compose(
    rgba: Image, drawn: tuple[tuple[PerturbationKind, float], ...], rng: np.random.Generator
) -> Image | None:
    """Apply kinds one after the other; None where nothing of the object is left."""
    for kind, severity in drawn:
        rgba = kind(rgba, severity, rng)
        if not _opaque(rgba):
            return None
    return rgba


def surroundings(rgba: Image, finest: float) -> Image:
    """Cut to a rectangle around the object, as far as the picture has it; shrink if need be.

    `finest` is the longest extent in pixels that is kept.
    """
    box = find_object(rgba)
    edge = int(np.ceil(_ROOM * box.extent))
    rows = slice(max(box.top - edge, 0), box.bottom + edge)
    columns = slice(max(box.left - edge, 0), box.right + edge)
    cut = rgba[rows, columns].copy()
    scale = shrinking(box.extent, finest, 1.0)
    if scale == 1:
        return cut
    size = (round(cut.shape[1] * scale), round(cut.shape[0] * scale))
    small = cv2.resize(premultiplied(cut), size, interpolation=cv2.INTER_AREA)
    return straight(np.asarray(small, np.float32))


def _opaque(rgba: Image) -> int:
    return int(np.count_nonzero(rgba[..., 3] > OPAQUE))


def _passes(rgba: Image) -> bool:
    try:
        check_crop(rgba, "perturbed image")
    except InputError:
        return False
    return True


def write_sheet(rgba: Image, config: PerturbationConfig, seed: int, path: Path) -> None:
    """Draw the sheet of one picture as PNG.

    Each kind is a row of five severities over light grey, with equal random draws, so that one
    fault grows from left to right. Below are ten results of the whole configuration as the model
    gets them: square and on black. Kinds of weight 0 are shown too.

    Raises:
        InputError: `rgba` is refused by `recast.trellis.check_crop`.
    """
    around = _with_margin(surroundings(rgba, config.finest))
    kinds = config.kinds()
    rows = -(-len(kinds) // 2)
    cell_height, cell_width = _cell(around).shape[:2]
    column_width = _LABEL + len(SEVERITIES) * (cell_width + _SPACE)
    width, foot = 2 * column_width + _GAP, _HEAD + rows * (cell_height + 6) + 14
    canvas = np.full((foot + _CELL + 78, width, 3), 255, np.uint8)

    def put(picture: Image, left: int, top: int) -> None:
        canvas[top : top + picture.shape[0], left : left + picture.shape[1]] = picture

    draw_text(canvas, (12, 29), "Perturbations from severity 0 to 1", _INK, 18, "ls")
    for index, kind in enumerate(kinds):
        column, row = divmod(index, rows)
        left, top = column * (column_width + _GAP), _HEAD + row * (cell_height + 6)
        draw_text(canvas, (left + 6, top + cell_height // 2), kind.name, _INK, 11, "ls")
        if kind.weight == 0:
            draw_text(canvas, (left + 6, top + cell_height // 2 + 16), "(off)", _INK, 11, "ls")
        for place, severity in enumerate(SEVERITIES):
            x = left + _LABEL + place * (cell_width + _SPACE)
            if row == 0:
                draw_text(
                    canvas, (x + cell_width // 2, _HEAD - 8), f"{severity:g}", _MUTED, 12, "ls"
                )
            rng = np.random.default_rng([seed, index])
            put(_cell(kind(around, severity, rng)), x, top)
    clean = f"clean with probability {config.rho_clean:g}"
    words = f"Drawn by this configuration, as the model gets them ({clean})"
    draw_text(canvas, (12, foot + 14), words, _INK, 15, "ls")
    side = min((width - 24) // _DRAWS - _SPACE, _CELL)
    for place in range(_DRAWS):
        drawn = perturb(rgba, config, np.random.default_rng([seed, len(kinds), place]))
        x = 12 + place * (side + _SPACE)
        put(crop_to_object(drawn.rgba, side), x, foot + 26)
        captions = [f"{name} {severity:.2f}" for name, severity in drawn.applied] or ["clean"]
        for line, caption in enumerate(captions):
            draw_text(canvas, (x, foot + 40 + side + 12 * line), caption, _MUTED, 10, "ls")
    files.write_bytes(path, encode(canvas))


def _with_margin(rgba: Image) -> Image:
    """Cut to the object and some room around it, transparent where the picture ends."""
    box = find_object(rgba)
    edge = round(_MARGIN * box.extent)
    padded = np.pad(rgba, ((edge, edge), (edge, edge), (0, 0)))
    return padded[box.top : box.bottom + 2 * edge, box.left : box.right + 2 * edge]


def _cell(rgba: Image) -> Image:
    """Over the panel, scaled to the size of a cell."""
    scale = _CELL / max(rgba.shape[:2])
    size = (max(round(rgba.shape[1] * scale), 1), max(round(rgba.shape[0] * scale), 1))
    shrink = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    mixed = cv2.resize(premultiplied(rgba), size, interpolation=shrink)
    over = mixed[..., :3] + _PANEL * (1 - mixed[..., 3:])
    return np.round(255 * np.clip(over, 0, 1)).astype(np.uint8)
