"""Sampler settings: what is accepted, the published layout, and the times visited."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.trellis.sampler import SamplerSettings, time_steps
from support.trellis import golden_tensors


def test_schedules_are_the_published_ones_to_the_bit() -> None:
    golden = golden_tensors("sampler_ss")

    np.testing.assert_array_equal(time_steps(SamplerSettings(steps=6)), golden["t_seq"].numpy())
    np.testing.assert_array_equal(time_steps(SamplerSettings()), golden["t_seq25"].numpy())


@given(steps=st.integers(1, 200), rescale=st.floats(0.01, 100))
def test_times_fall_strictly_from_one_to_zero(steps: int, rescale: float) -> None:
    times = time_steps(SamplerSettings(steps=steps, rescale_t=rescale))

    assert times.dtype == np.float64
    assert len(times) == steps + 1
    assert times[0] == 1.0
    assert times[-1] == 0.0
    assert (np.diff(times) < 0).all()


@given(steps=st.integers(1, 200))
def test_without_rescaling_times_are_evenly_spaced(steps: int) -> None:
    times = time_steps(SamplerSettings(steps=steps, rescale_t=1.0))

    np.testing.assert_allclose(np.diff(times), -1 / steps, rtol=1e-9)


@given(steps=st.integers(2, 50), rescale=st.floats(0.05, 20))
def test_rescaling_by_the_inverse_mirrors_the_times(steps: int, rescale: float) -> None:
    times = time_steps(SamplerSettings(steps=steps, rescale_t=rescale))
    inverse = time_steps(SamplerSettings(steps=steps, rescale_t=1 / rescale))

    np.testing.assert_allclose(1 - times[::-1], inverse, atol=1e-12)


@pytest.mark.parametrize(("steps", "guided"), [(25, 19), (12, 10)])
def test_number_of_guided_steps(steps: int, guided: int) -> None:
    settings = SamplerSettings(steps=steps)

    assert sum(settings.guided(t) for t in time_steps(settings)[:-1]) == guided


def test_the_first_step_is_guided_whatever_rounding_does() -> None:
    # 0.1 / (1 + (0.1 - 1)) is above 1 in floating point.
    settings = SamplerSettings(rescale_t=0.1, cfg_interval=(0.9, 1.0))

    assert settings.guided(time_steps(settings)[0])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("steps", 0),
        ("steps", 2.5),
        ("steps", True),
        ("cfg_strength", -1.0),
        ("cfg_strength", float("nan")),
        ("cfg_strength", "5"),
        ("cfg_interval", (0.8, 0.2)),
        ("cfg_interval", (-0.1, 1.0)),
        ("cfg_interval", (0.5, float("nan"))),
        ("cfg_interval", (0.5,)),
        ("cfg_interval", ("0.5", "1.0")),
        ("rescale_t", 0.0),
        ("rescale_t", float("inf")),
        ("sigma_min", 1.0),
        ("stpes", 5),
    ],
)
def test_a_wrong_override_is_named(field: str, value: Any) -> None:
    with pytest.raises(InputError) as caught:
        SamplerSettings().merged(**{field: value})

    assert caught.value.field.split(".")[0] == field
    assert "\n" not in str(caught.value)


def test_overrides_replace_what_they_name() -> None:
    merged = SamplerSettings(rescale_t=2.0).merged(steps=12, cfg_strength=7.5, cfg_interval=None)

    assert merged == SamplerSettings(steps=12, cfg_strength=7.5, rescale_t=2.0)


PUBLISHED: dict[str, Any] = {
    "name": "FlowEulerGuidanceIntervalSampler",
    "args": {"sigma_min": 1e-5},
    "params": {"steps": 25, "cfg_strength": 5.0, "cfg_interval": [0.5, 1.0], "rescale_t": 3.0},
}


def test_the_published_record_is_the_default_and_comes_back() -> None:
    settings = SamplerSettings.from_published(PUBLISHED, "pipeline.json")

    assert settings == SamplerSettings()
    assert settings.published() == PUBLISHED


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"name": "DdimSampler"}, "name"),
        ({"args": {}}, "args.sigma_min"),
        ({"params": None}, "params"),
        ({"params": {**PUBLISHED["params"], "eta": 1}}, "params.eta"),
        ({"params": {**PUBLISHED["params"], "cfg_interval": [1.0, 0.5]}}, "cfg_interval"),
    ],
)
def test_a_record_of_another_layout_is_refused(change: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        SamplerSettings.from_published({**PUBLISHED, **change}, "pipeline.json")

    assert (caught.value.where, caught.value.field) == ("pipeline.json", field)
