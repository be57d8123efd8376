"""What holds for every configuration and record of the package."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel, ValidationError

import recast
from recast.core.records import Record

SOURCE = Path(recast.__file__).parent


def models() -> Iterator[type[BaseModel]]:
    for path in sorted(SOURCE.rglob("*.py")):
        if "pydantic" in (text := path.read_text()) or "import Record" in text:
            name = ".".join(path.relative_to(SOURCE.parent).with_suffix("").parts)
            importlib.import_module(name.removesuffix(".__init__"))
    waiting = list(BaseModel.__subclasses__())
    while waiting:
        one = waiting.pop()
        waiting += one.__subclasses__()
        if one.__module__.startswith("recast."):
            yield one


def test_no_configuration_and_no_record_takes_nan_or_infinity() -> None:
    found = {f"{one.__module__}.{one.__qualname__}": one.model_config for one in models()}
    assert len(found) > 60
    lenient = [name for name, config in found.items() if config.get("allow_inf_nan") is not False]
    assert not lenient


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_the_base_refuses_them_wherever_they_stand(value: str) -> None:
    class Inner(Record):
        x: float = 0.0

    class Outer(Record):
        one: float = 0.0
        several: tuple[float, ...] = ()
        named: dict[str, str | float] = {}  # noqa: RUF012
        inner: Inner = Inner()

    number = float(value)
    for wrong in ({"one": number}, {"several": [1.0, number]}, {"named": {"a": number}}):
        with pytest.raises(ValidationError, match="finite number"):
            Outer.model_validate(wrong)
    with pytest.raises(ValidationError, match="finite number"):
        Outer.model_validate({"inner": {"x": number}})
