"""The generated reference: all commands, options and fields; every option says what it does."""

from __future__ import annotations

import importlib.util
import re
from types import ModuleType

import pytest
import yaml

from support.doc_blocks import REPOSITORY


@pytest.fixture(scope="module")
def hook() -> ModuleType:
    """The MkDocs hook that makes the pages."""
    path = REPOSITORY / "docs" / "make_reference.py"
    spec = importlib.util.spec_from_file_location("make_reference", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_option_of_every_command_says_what_it_does(hook: ModuleType) -> None:
    page = hook.command_line()
    rows = re.findall(r"^\| (`[^|]*`) \| .* \| (.*) \|$", page, re.MULTILINE)
    assert len(rows) > 300 and all(text.strip() for _, text in rows)
    for words, parser in hook.commands():
        assert f"recast {words}\n" in page, words
        assert parser.description.strip(), words
    run = page.split("## recast run\n")[1].split("\n## ")[0]
    assert "| `LOG` | `PATH` | required |" in run and "| `--track` | `STR` | required |" in run


def test_every_field_of_a_configuration_is_there(hook: ModuleType) -> None:
    page = hook.configuration()
    scene = page.split("### SceneConfig\n")[1].split("\n## ")[0]
    from recast.reconstruction import SceneConfig

    assert set(re.findall(r"^\| `(\w+)` \|", scene, re.MULTILINE)) == set(SceneConfig.model_fields)
    assert "| `iterations` | integer, ≥ 1 | `2800` |" in scene
    assert "| `smpl_model` | text |" in scene


def test_the_navigation_has_all_pages_of_the_api(hook: ModuleType) -> None:
    text = (REPOSITORY / "mkdocs.yml").read_text()
    nav = yaml.safe_load(text.split("\nhooks:")[0].split("\nextra_css:")[0])["nav"]
    for name in (*hook.LOOSE, *hook.PACKAGES):
        assert f"reference/api/{name}.md" in str(nav), name
        assert hook.api_page(name).endswith(f"::: {name}\n")
