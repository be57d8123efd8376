"""What commands share: options with one help text each, and what is printed.

The JSON of every command has one form: a list of objects. Each object is one row; its member
`table` names the table. Keys end in the unit (`download_gb`, `psnr_db`, `duration_s`); in a row
about one metric, `unit` holds it. Values are strings, booleans, finite numbers, null for unknown,
or lists of these.
"""

from __future__ import annotations

import json
import math
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import make_dataclass
from functools import reduce
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from recast.core.errors import InputError, printable
from recast.core.plugins import entry_points, splat_formats

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from rich.console import Console

    from recast.scene.exchange import ImportRecord


Names = tyro.conf.UseAppendAction[tuple[str, ...]]
"""Words of an option that may be repeated."""
Commands = Mapping[str, Callable[..., Any]]


def one_of(commands: Commands) -> Any:
    """The type of one of these commands, by their names."""
    named = (Annotated[kind, tyro.conf.subcommand(name)] for name, kind in commands.items())
    return reduce(or_, named)


def with_installed(path: str, commands: Commands) -> Commands:
    """Commands with those that other packages add: entry points of the group `recast.commands`.

    Args:
        path: words of the command they belong to, such as "scene import"; empty for `recast`. The
            name of an entry point is all words with dots between, such as "scene.import.mtgs".
    """
    found = dict(commands)
    for entry in entry_points("recast.commands"):
        above, _, word = entry.name.rpartition(".")
        if above == path.replace(" ", "."):
            found[word] = _loaded(entry)
    return found


def _loaded(entry: EntryPoint) -> Callable[..., Any]:
    """The class of an installed command; one that says why if it cannot be imported."""
    try:
        command: Callable[..., Any] = entry.load()
    except Exception as error:
        problem = f"cannot be imported ({type(error).__name__}: {error})"
        refusal = InputError("command", entry.name, problem, "install its package again")

        def refuse(_command: object) -> None:
            raise refusal

        command = make_dataclass(
            "Broken", [], namespace={"__doc__": f"Broken: {problem}", "__call__": refuse}
        )
    return command


def group(path: str, text: str, commands: Commands) -> type:
    """A command that does nothing but one of these; its class has them as `commands`.

    Args:
        path: see `with_installed`.
    """
    commands = with_installed(path, commands)
    members = {"__doc__": text, "__call__": lambda self: self.command(), "commands": commands}
    return make_dataclass("Group", [("command", one_of(commands))], frozen=True, namespace=members)


def option(
    text: str, default: str = "", *, metavar: str | None = None, aliases: tuple[str, ...] = ()
) -> Any:
    """Help of an option whose default is None, empty or a plain value.

    Args:
        default: what None or an empty list stands for; empty for an option that may be left out.
        metavar: name of the value in the help; the type if None.
        aliases: other spellings, such as "--motions".
    """

    def shown(value: str) -> str:
        if value not in ("None", ""):
            return f"(default: {value})"
        return f"(default: {default})" if default else "(optional)"

    return tyro.conf.arg(help=text, metavar=metavar, help_behavior_hint=shown, aliases=aliases)


def required(text: str) -> Any:
    """Help of an option or argument that must be given."""
    return tyro.conf.arg(help=text)


def several(metavar: str, hint: str = "required") -> Any:
    """Form of an argument or option of several values, or of None; its field has the text.

    Args:
        metavar: name of the values in the help.
        hint: what the help says in place of an empty default.
    """
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=lambda _: f"({hint})")


# What is driven.
TRACK_HELP = "Id of the track to replace and control; `recast log info LOG` lists the ids."
MOTION_HELP = (
    "Motion of the controlled actor: cut-in, oncoming, stationary or advancing (both settings), "
    "one setting such as cut-in-a, or a scenario file (.yaml). May be repeated."
)
MOTIONS_HELP = MOTION_HELP.replace("May be repeated", "Takes several, and may be repeated")
ARM_HELP = (
    "Arm of the comparison; the first is the baseline: native (the vehicle as reconstructed), "
    "replaced (a generated vehicle), oracle (the truth of a synthetic log), a generator such as "
    "recast-mini, a street such as omnire or a scene folder, both such as omnire+template, "
    "noise-floor (the truth disturbed in four ways), decomposition (truth and reconstruction in "
    "all pairings), or a file of arms (recast docs runs#arms). May be repeated."
)
ARM_DEFAULT = "native and replaced"
ARM = option(ARM_HELP, ARM_DEFAULT)
PLANNER_HELP = (
    "Planner under test: a name that `recast doctor` lists, a planner folder, "
    "package.module:attribute, alpasim:HOST:PORT (a driver of AlpaSim) or neuroncap:HOST:PORT. "
    "May be repeated."
)
PLANNER = option(PLANNER_HELP, "gtrs-mini")
PLANNER_DEVICE = option(
    "Device of the planner: auto (a GPU if there is one), cpu, cuda or cuda:1.",
    "auto",
    metavar="DEVICE",
)
RESTORER = option(
    "Restorer of the rendered images: harmonizer:HOST:PORT (NVIDIA's Harmonizer), the name of an "
    "installed restorer, or package.module:attribute. Images of the truth are never restored.",
    metavar="NAME",
)
METRIC = option(
    "Metric of your own beside recast's: package.module:attribute, or the name of an installed "
    "one. May be repeated.",
    metavar="NAME",
)
STEPS = option("Steps of 0.1 s for each rollout; fewer if the log or the road ends.", "160")
COMPLETE = option(
    "Road users beside the target that are made complete, too: all, near (within 30 m of the "
    "recorded ego), or a track id. May be repeated.",
    "none",
    metavar="TRACK",
)
Traffic = Annotated[
    Literal["none", "replay", "idm"] | None,
    option(
        "What other recorded road users do: none takes them out, replay leaves them on their "
        "recorded motion, idm lets them give way on their recorded paths.",
        "none",
    ),
]

# What the actor is made from.
GENERATOR = option(
    "Generator of the actor: auto (the better of template and parametric; people for pedestrians "
    "and cyclists), recast-mini (the image-to-3D model in the package), parametric, template, "
    "people, the name of an installed "
    "generator, trellis (recast weights), a model folder, a file of Gaussians (PLY, GLB, SPZ, "
    "USDA) or of a mesh (GLB, OBJ), or library:FOLDER (the best vehicle in that folder).",
    "auto",
    metavar="NAME",
)
AXES = option(
    "Axes of vehicle files or of a model folder: the axis that points up, such as z-up, y-up or "
    "minus-y-up, or forward and up, such as x,z (write --axes=-y,z with a minus). auto finds a "
    "file's axes from its shape and takes z-up for models.",
    "auto",
    metavar="AXES",
)
Refine = Annotated[
    tyro.conf.FlagConversionOff[bool | None],
    option("Refine the actor on all images of the log (about a minute).", "True"),
]
SEGMENTER = option(
    "Segmenter that cuts the vehicle out of the images: box-lidar, the name of an installed "
    "segmenter, grounded-sam (recast weights), or a folder with grounding-dino and sam "
    "(recast docs actors).",
    "box-lidar",
    metavar="NAME",
)
VIEWS = option(
    "Maximum number of images that the actor is made from: the best view, then other sides.", "1"
)

# What is written for other programs.
FormatName: Any = Literal[splat_formats()]
SPLAT_FORMAT = option(
    "Format of the Gaussians: ply (3D Gaussian splatting), gltf (GLB with KHR_gaussian_splatting); "
    "with recast-bridges spz (Niantic, quantised) or usd (OpenUSD text).",
    "ply",
)

# Where the street comes from.
SCENE = option("Folder of a trained or imported scene; no scene is trained.")
STORE_HELP = "Folder or address (s3://...) of the artefacts that runs share."
PRESET = option(
    "Reconstruction method: streetgs (Street Gaussians) or omnire (OmniRe).", "recast's own"
)
CONFIG_HELP = (
    "Configuration file (JSON, recast docs runs#a-configuration-file); options override it."
)
SCENE_CONFIG = option(
    "Scene configuration file (JSON, recast docs scenes#configuration); it overrides the preset, "
    "and options override it."
)
CAMERAS = option(
    "Names of the cameras to use.", "all cameras of the log", metavar="NAME [NAME ...]"
)
SCALE_HELP = "Image scale; 0.5 uses half the recorded width and height."
ITERATIONS_HELP = "Training steps of the scene."

WORLD_FROM_SCENE = option(
    "Text file with a 4x4 matrix or an offset from the scene's coordinates to the log's world."
)

# How it is computed.
SEED_HELP = "Seed of all random choices."
SEED = option(SEED_HELP, "0")
THREADS = option("Number of CPU threads; 0 uses all cores.", "0")
WORKERS = option("Number of worker processes; results do not depend on it.")
RAY = option(
    "Address of a Ray cluster (auto or ray://HOST:10001), or local; needs the extra distributed.",
    metavar="ADDRESS",
)
DEVICE = option("Device: cpu, cuda or cuda:1.", "cuda if there is a GPU, else cpu", metavar="NAME")
LIMIT = option("Number of vehicles to use, the first by id.", "all")
SAMPLES = option("Number of bootstrap samples of the confidence intervals.")

ALLOW_HOST = option(
    "Further name of this machine that clients may use, such as that of a container. May be "
    "repeated.",
    metavar="NAME",
)

# Networks that judge.
LPIPS_WEIGHTS = option(
    "Weights for LPIPS: an AlexNet or VGG-16 file of torchvision, or alexnet or vgg16 (recast "
    "weights).",
    "no LPIPS",
    aliases=("--lpips",),
)
CLIP = option(
    "CLIP model for the image similarity: a folder, or clip-vit-l14 (recast weights).",
    "no CLIP score",
)
DINO = option(
    "DINOv2 model for the feature distance: a folder, or dinov2 (recast weights).", "no DINO score"
)
INCEPTION = option(
    "Inception weights for the Frechet distance: a file (.pth or .safetensors), or inception "
    "(recast weights).",
    "no Inception score",
)
IMAGE_ENCODER = option(
    "Weights of the image encoder (DINOv2 ViT-L/14 with registers), or dinov2 (recast weights).",
    "the model folder's",
)

_RUN_OPTIONS = {
    "arms": "arm",
    "scene_folder": "scene",
    "preset": "preset",
    "planners": "planner",
    "planner_device": "planner_device",
    "plan_limit_s": "plan_timeout",
    "films": "films",
    "restorer": "restorer",
    "metrics": "metric",
    "generator": "generator",
    "axes": "axes",
    "refine": "refine",
    "segmenter": "segmenter",
    "views": "views",
    "complete": "complete",
    "traffic": "traffic",
    "steps": "steps",
    "seed": "seed",
    "threads": "threads",
}
_SCENE_OPTIONS = ("cameras", "scale", "iterations", "seed", "threads")


def run_options(command: object) -> dict[str, Any]:
    """The members of `RunConfig` that a command's options set; None for those not given."""
    found: dict[str, Any] = {
        member: getattr(command, name, None) for member, name in _RUN_OPTIONS.items()
    }
    for several in ("arms", "planners", "metrics", "complete"):
        found[several] = found[several] or None
    if found["scene_folder"] is not None:
        found["scene_folder"] = str(found["scene_folder"].absolute())
    return found


def scene_options(command: object) -> dict[str, Any]:
    """The members of `SceneConfig` that a command's options set; None for those not given."""
    return {name: getattr(command, name, None) for name in _SCENE_OPTIONS}


Rows = Mapping[str, Iterable[Mapping[str, Any]]]
"""Rows by table name."""

JSON = tyro.conf.arg(
    help="Print the tables as one JSON list on standard output, and everything else on standard "
    "error."
)
EXTRAS_PAGE = "docs/install.md#extras"

_VEHICLES = "docs/actors.md#bring-your-own-vehicle"
_SCENARIO_FILE = "docs/scenarios.md#your-own-as-a-file"

PAGES = {
    "recast.actors.generate": "docs/actors.md#axes",
    "recast.actors.library": "docs/actors.md#a-library-of-vehicles",
    "recast.actors.mesh": _VEHICLES,
    "recast.actors.vehicle_files": _VEHICLES,
    "recast.core.artefact": "docs/runs.md#the-store",
    "recast.core.store": "docs/runs.md#the-store",
    "recast.metrics.trust": "docs/trust.md",
    "recast.logs": "docs/data.md#the-log-folder",
    "recast.logs.importers": "docs/data.md#what-can-be-read",
    "recast.runs.arms": "docs/runs.md#arms",
    "recast.studies.trust": "docs/trust.md#calibrate",
    "recast.runs.config": "docs/runs.md#a-configuration-file",
    "recast.runs.run_folder": "docs/runs.md#the-run-folder",
    "recast.planning": "docs/planners.md#your-own-planner",
    "recast.planning.registry": "docs/planners.md#built-in",
    "recast.simulation.renderer": "docs/runs.md#restored-images",
    "recast.recar": "docs/recar.md",
    "recast.reconstruction.config": "docs/scenes.md#configuration",
    "recast.simulation.scenario": _SCENARIO_FILE,
    "recast.splats.cuda": "docs/rasterizer.md#on-a-gpu",
    "recast.synthetic": "docs/synthetic.md",
    "recast.trellis.checkpoints": "docs/image_to_3d.md#model-folders",
    "recast.weights": "docs/weights.md#names",
}
"""Page by module or package; the innermost package counts. Packages of plug-ins may have theirs in
an attribute `PAGES` of the outermost one."""


def console_for(as_json: bool) -> Console:
    """The console for progress and messages: standard error if the output is JSON."""
    from rich.console import Console

    return Console(stderr=as_json)


def print_json(tables: Rows) -> None:
    """Print the rows of all tables as one JSON list.

    Args:
        tables: values of rows are plain, numpy or path-like; NaN and infinity become null.
    """
    rows = [
        {"table": name, **{key: _plain(value) for key, value in row.items()}}
        for name, table in tables.items()
        for row in table
    ]
    print(json.dumps(rows, indent=2, allow_nan=False))


def with_unit(name: str, unit: str) -> str:
    """The key of a quantity: its name, and its unit in words."""
    words = {"%": "percent", "dB": "db", "m/s": "mps", "m/s^2": "mps2", "of v_r": "of_v_r"}
    ending = words.get(unit, unit.lower())
    return f"{name}_{ending}" if ending else name


def _plain(value: Any) -> Any:
    if hasattr(value, "item") and not hasattr(value, "__len__"):  # numpy's numbers
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return value


def line_of(error: InputError, command: object = None) -> str:
    """The error's line: settings in backquotes as options of the command, and the page that helps.

    Args:
        command: that was run; None if its words were not understood.
    """
    options: set[str] = set()
    while command is not None:
        options |= vars(command).keys()
        command = getattr(command, "command", None)

    def shown(match: re.Match[str]) -> str:
        return "--" + match[1].replace("_", "-") if match[1] in options else match[0]

    where, field, mend = (
        re.sub("`([a-z_]+)`", shown, text) for text in (error.where, error.field, error.mend)
    )
    page = page_of(error)
    mend, page = topics_named(mend), page and topics_named(page)
    return InputError(where, field, error.problem, mend).line(page)


def topics_named(text: str) -> str:
    """`text` with each page that it names, such as docs/runs.md#arms, as a command prints it."""
    return re.sub(r"\bdocs/([\w/]+)\.md\b", r"recast docs \1", text)


def page_of(error: InputError) -> str | None:
    """The page to name after the error's line; None if there is none, or the line names one.

    An `InputError` may name its page. Other errors get the page of the part of recast that raised
    them: the innermost function with a page counts.
    """
    if error.page is not None or "docs/" in error.mend:
        return error.page
    if "recast-sim[" in error.mend:
        return EXTRAS_PAGE
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        module = frame.f_globals.get("__name__", "") + "."
        package = sys.modules.get(module.partition(".")[0])
        pages = {**PAGES, **getattr(package, "PAGES", {})}
        matching = (name for name in pages if module.startswith(f"{name}."))
        found = max(matching, key=len, default=None)
        if found is not None:
            return str(pages[found])
    return None


def without_images(cameras: Sequence[str]) -> list[str]:
    """A line that names cameras of which a log has no image; none if there are none."""
    listed = ", ".join(map(printable, cameras))
    return [f"no images of {listed}: the log has their calibration only"] if listed else []


def run_import(make: Callable[..., ImportRecord], log: Path, out: Path, **options: Any) -> None:
    """Call an importer with a command's options; the first is its file."""
    from recast.logs import read_log

    path = options.pop(next(iter(options)))
    tell_import(make(path, read_log(log), out, **options), out)


def tell_import(record: ImportRecord, out: Path) -> None:
    """Print what an import made."""
    from recast.cli.rows.logs import import_lines

    console = console_for(False)
    for line, style in import_lines(record):
        console.print(line, style=style, markup=False, highlight=False)
    console.print(f"wrote {out}", markup=False)
