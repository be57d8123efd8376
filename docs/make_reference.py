"""MkDocs hook: makes the reference pages from the code, and orders the results of the search.

Command line from the parsers of `recast`, configuration tables from the pydantic models, and one
page of the API for each package. None of these pages is a file in the repository.
"""

from __future__ import annotations

import importlib
import re
import types
import typing
from collections.abc import Iterator
from typing import Any

import docstring_parser
import tyro
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pydantic import BaseModel
from pydantic_core import PydanticUndefined
from tyro import _parsers, _singleton

import recast
from recast.cli.main import Command

PACKAGES = {
    "recast.logs": "Logs and maps",
    "recast.scene": "Street scenes",
    "recast.reconstruction": "Reconstruction of street scenes",
    "recast.actors": "Vehicles",
    "recast.planning": "Planners",
    "recast.planning.gtrs": "GTRS planners",
    "recast.planning.pdm": "PDM-Closed",
    "recast_bridges.navsim": "NAVSIM agents",
    "recast.simulation": "Closed loop",
    "recast.metrics": "Metrics",
    "recast.reporting": "Reports, films and pictures",
    "recast.viewer": "Viewer and replays",
    "recast.envs": "Gymnasium environments",
    "recast_bridges.alpasim": "AlpaSim and NuRec",
    "recast_bridges.neuroncap": "NeuroNCAP",
    "recast.synthetic": "Synthetic world",
    "recast.recar": "Vehicle sets",
    "recast.trellis": "Image-to-3D model",
    "recast.splats": "Gaussians and the rasterizer",
    "recast.dynamics": "Vehicle dynamics",
    "recast.geometry": "Poses and boxes",
    "recast.cameras": "Cameras, lenses and mounts",
    "recast.core": "Store of artefacts",
    "recast.weights": "Published weights",
}
"""Packages with a page of their public names (`__all__`), in the order of the overview."""
LOOSE = {"recast.face": "From a log to a report", "recast.core.errors": "Errors"}
"""Modules without `__all__` that `recast` takes names from."""
MODELS = {
    "Runs": (
        ("recast.runs.config", "RunConfig", "`config` in `run.json`, and files for `--config`"),
        ("recast.runs.arms", "Arm", "one of `arms`, and one entry of a file for `--arm`"),
    ),
    "Scenes": (
        (
            "recast.reconstruction.config",
            "SceneConfig",
            "`scene` in `run.json`, `config.json` of a scene, and files for `--scene-config`",
        ),
    ),
    "Training of the image-to-3D model": (
        ("recast.recar.target_maker", "TargetSettings", "settings of the pseudo-targets"),
        ("recast.recar.target_maker", "FilterSettings", "`filter` of the pseudo-targets"),
        ("recast.recar.perturb", "PerturbationConfig", "file for `--perturbations`"),
        ("recast.recar.training_config", "StageConfig", "one stage of `recast recar train`"),
        ("recast.recar.training_config", "FlowObjective", "`objective` of a stage"),
        ("recast.training.state", "TrainerSettings", "`trainer` of a training"),
    ),
    "Training of the small planner": (
        (
            "recast_tools.planner_training.task",
            "PlannerTrainingConfig",
            "file for `--config` of `recast planner train`",
        ),
    ),
}
API_BOOST = 0.01
"""Weight of the API in the search: below every heading of a guide, above single words of its text
(the theme gives headings 1000 times the weight of text)."""
SEARCHED = {
    "scenarios.md": ["cut-in", "oncoming", "stationary", "advancing"],
    "planners.md": ["gtrs-mini", "pdm-closed", "idm-follower"],
    "image_to_3d.md": ["recast-mini"],
    "runs.md": ["native", "replaced"],
    "search.md": ["boundary"],
    "limits.md": ["limits", "limitations"],
}
"""Words for which the search shows a page first, though none of its headings has them."""


def on_config(config: MkDocsConfig) -> None:
    """Say at the foot of every page which version it is of."""
    config.copyright = f"recast {recast.__version__}"


def on_page_markdown(markdown: str, *, page: Page, **_: Any) -> None:
    """Order the search: guides before the API, and pages by their `SEARCHED` words."""
    path = page.file.src_uri
    if path.startswith("reference/api/"):
        page.meta["search"] = {"boost": API_BOOST}
    page.meta["tags"] = SEARCHED.get(path)


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    pages = {
        "reference/command_line.md": command_line(),
        "reference/configuration.md": configuration(),
        "reference/api/index.md": api_overview(),
        **{f"reference/api/{name}.md": api_page(name) for name in (*LOOSE, *PACKAGES)},
    }
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


# Command line


def commands() -> Iterator[tuple[str, _parsers.ParserSpecification]]:
    """Every command of `recast` that runs something, such as "scene train", with its parser."""
    root = _parsers.ParserSpecification.from_callable_or_type(
        typing.cast(Any, Command),
        markers={
            tyro.conf.OmitSubcommandPrefixes,
            tyro.conf.OmitArgPrefixes,
            tyro.conf.DisallowNone,
        },
        description="",
        parent_classes=set(),
        default_instance=_singleton.MISSING_NONPROP,
        intern_prefix="",
        extern_prefix="",
        subcommand_prefix="",
        support_single_arg_types=True,
        prog_suffix="",
    )
    yield from _leaves(root, ())


def _leaves(
    parser: _parsers.ParserSpecification, words: tuple[str, ...]
) -> Iterator[tuple[str, _parsers.ParserSpecification]]:
    if not parser.subparsers_from_intern_prefix:
        yield " ".join(words), parser
    for group in parser.subparsers_from_intern_prefix.values():
        for name, lazy in group.parser_from_name.items():
            yield from _leaves(lazy.evaluate(), (*words, name))


def command_line() -> str:
    """The page of all commands with their arguments and options."""
    lines = [
        "# Command line\n",
        "Every command, with its arguments and options. `recast COMMAND --help` prints the same.\n",
        "Every command also takes `--verbose` (show debug records and the tracebacks of errors) "
        "and `--log-file FILE` (append the same records to FILE). `recast --version` prints the "
        "version.\n",
    ]
    group = ""
    for words, parser in commands():
        if words.split()[0] != group:
            group = words.split()[0]
            lines.append(f"## recast {group}\n")
        if words != group:
            lines.append(f"### recast {words}\n")
        lines.append(_plain(parser.description) + "\n")
        rows = [_option(one.arg) for one in parser.get_args_including_children()]
        if rows:
            lines.append("| argument or option | value | default | what it does |")
            lines.append("|---|---|---|---|")
            lines += [*rows, ""]
    return "\n".join(lines)


def _option(argument: Any) -> str:
    lowered, field = argument.lowered, argument.field
    positional = not lowered.name_or_flags[-1].startswith("-")
    name = field.intern_name.upper() if positional else lowered.name_or_flags[-1]
    if lowered.metavar is None and field.default is True:
        name += f"`, `--no-{name[2:]}"
    value = str(lowered.metavar or "").replace("{None}|", "").replace("None,", "")
    value = value.replace("{[STR [STR ...]]}", "STR ...").replace("[STR [STR ...]]", "STR ...")
    text = field.helptext() if callable(field.helptext) else field.helptext
    return f"| `{name}` | {_code(value)} | {_default(lowered, field)} | {_cell(text or '')} |"


def _default(lowered: Any, field: Any) -> str:
    if lowered.required:
        return "required"
    default = "" if field.default is None or field.default is False else field.default
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else str(default)
    if callable(hint := field.argconf.help_behavior_hint):
        told = hint(shown).removeprefix("(").removesuffix(")")
        return _cell(told.removeprefix("default: ")) if told != "optional" else ""
    return f"`{shown}`" if shown else ""


# Configuration


def configuration() -> str:
    """The page of the configuration files, a table for each model."""
    lines = [
        "# Configuration\n",
        "Fields of the JSON files that recast reads and writes. A file names only the fields that "
        "differ from their defaults, except where a field is marked as required. An unknown field, "
        "a value of another type, or a number that is not finite ends in one line that names "
        "it.\n",
    ]
    for title, models in MODELS.items():
        lines.append(f"## {title}\n")
        for module, name, use in models:
            model = getattr(importlib.import_module(module), name)
            lines.append(f"### {name}\n")
            lines.append(f"{use[0].upper()}{use[1:]}.\n".replace("`.\n", "`.\n"))
            lines += ["| field | type | default | what it is |", "|---|---|---|---|"]
            lines += [*_fields(model), ""]
    return "\n".join(lines)


def _fields(model: type[BaseModel]) -> Iterator[str]:
    told = _attribute_texts(model)
    for name, field in model.model_fields.items():
        default = field.get_default(call_default_factory=True, validated_data={})
        if default is PydanticUndefined:
            shown = "required"
        elif isinstance(default, BaseModel) or _models_in(default):
            shown = "see its own table"
        else:
            shown = f"`{_json_like(default)}`"
        text = field.description or told.get(name, "")
        limits = ", ".join(
            f"{sign} {getattr(rule, key)}"
            for rule in field.metadata
            for key, sign in (("ge", "≥"), ("gt", ">"), ("le", "≤"), ("lt", "<"))
            if hasattr(rule, key)
        )
        kind = _type_words(field.annotation)
        yield f"| `{name}` | {kind}{f', {limits}' if limits else ''} | {shown} | {_cell(text)} |"


def _attribute_texts(model: type[BaseModel]) -> dict[str, str]:
    """What the docstrings of a model and its parents say of each field."""
    found: dict[str, str] = {}
    for parent in reversed(model.__mro__[:-1]):
        if parent.__doc__ and parent is not BaseModel and issubclass(parent, BaseModel):
            for part in docstring_parser.parse(parent.__doc__).params:
                for name in part.arg_name.split(", "):
                    found[name] = (part.description or "").strip()
    return found


def _models_in(value: object) -> bool:
    return isinstance(value, tuple) and any(isinstance(one, BaseModel) for one in value)


def _json_like(value: object) -> str:
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, tuple):
        return "[" + ", ".join(_json_like(one) for one in value) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)


_WORDS = {str: "text", int: "integer", float: "number", bool: "true or false", type(None): "null"}


def _type_words(kind: Any) -> str:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return _type_words(arguments[0])
    if origin is typing.Literal:
        return " or ".join(f"`{_json_like(one)}`" for one in arguments)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_type_words(one) for one in arguments)
    if origin in (tuple, list):
        return "list of " + " or ".join(
            dict.fromkeys(_type_words(one) for one in arguments if one is not ...)
        )
    if origin is dict:
        return "object"
    return _WORDS.get(kind, f"`{getattr(kind, '__name__', kind)}`")


# API


def api_overview() -> str:
    """The page of `recast` itself: each public name with a link to what it is."""
    lines = [
        "# API\n",
        "The names of `import recast`. Each is imported when it is first used. The pages of the "
        "packages follow, with all their public names. [Library](../../library.md) shows how they "
        "are used.\n",
        "| name | from |",
        "|---|---|",
    ]
    for module, names in recast._PLACES.items():
        page = next(name for name in (module, *PACKAGES, *LOOSE) if name in {**PACKAGES, **LOOSE})
        if module == "recast.runs.arms":
            lines.append("| [`Arm`](../configuration.md#arm) | `recast.runs.arms` |")
            continue
        lines += [f"| [`{name}`][{module}.{name}] | [{page}]({page}.md) |" for name in names]
    lines += ["", "| package | what it has |", "|---|---|"]
    lines += [
        f"| [`{name}`]({name}.md) | {title} |" for name, title in {**LOOSE, **PACKAGES}.items()
    ]
    return "\n".join(lines)


def api_page(name: str) -> str:
    """The page of one module: all its public names."""
    return f"# {name}\n\n{({**PACKAGES, **LOOSE})[name]}.\n\n::: {name}\n"


# Text


def _plain(text: str) -> str:
    """Prose of a docstring; braces and angle brackets are not markup."""
    return text.replace("<", "&lt;").replace("::", "&#58;:")


def _cell(text: str) -> str:
    told = _plain(" ".join(text.split())).replace("|", "\\|")
    page = r"(?:docs/(\w+)\.md|recast docs (\w+))(#[\w-]+)?"
    return re.sub(page, r"[\1\2](../\1\2.md\3)", told)


def _code(value: str) -> str:
    return f"`{value}`".replace("|", "\\|") if value else ""
