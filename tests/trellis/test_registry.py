from __future__ import annotations

import json
import math
from typing import Any

import pytest
import torch

from recast.core.errors import InputError
from recast.trellis.flow_transformer import SLatFlowModel
from recast.trellis.model_files import MODEL_CLASSES, build
from support.trellis import golden_config, golden_tensors, official_keys

GOLDEN = ("ss_flow", "ss_enc", "ss_dec", "slat_flow", "slat_enc", "slat_dec_gs")


@pytest.mark.parametrize("name", GOLDEN)
def test_builds_from_the_published_configuration_and_loads(name: str) -> None:
    config = golden_config(name)
    model = build(config["name"], config["args"], "model.json")
    assert model.published_name == config["name"]
    model.load_published(golden_tensors(name))


@pytest.mark.parametrize("name", [*GOLDEN, "ss_flow_variant"])
def test_configurations_round_trip_through_json(name: str) -> None:
    args = golden_config(name)["args"]
    config = build(golden_config(name)["name"], args, "model.json").config
    assert config.model_dump(mode="json", by_alias=True, exclude_unset=True) == args
    whole = json.loads(config.model_dump_json(by_alias=True))
    assert whole.keys() >= args.keys()
    assert type(config).model_validate(whole) == config


def test_training_names_give_the_same_classes() -> None:
    assert MODEL_CLASSES["ElasticSLatFlowModel"] is SLatFlowModel
    published = {official["class"] for official in official_keys().values()}
    ours = {model.published_name for model in MODEL_CLASSES.values()}
    assert ours == published | {"CompactImageEncoder"}


@pytest.mark.parametrize(
    ("name", "changes", "said"),
    [
        (
            "SLatMeshDecoder",
            {},
            "model.json: name: 'SLatMeshDecoder' is not a known network; choose",
        ),
        ("SLatFlowModel", {"patch_size": 4}, "patch_size 4 is not 2 to the number of io_block"),
        ("SLatFlowModel", {"model_chanels": 4}, "model.json: model_chanels: Extra inputs"),
        ("SLatFlowModel", {"num_heads": 5}, "do not divide into 5 heads"),
        ("SLatFlowModel", {"pe_mode": "rope"}, "model.json: pe_mode: Input should be 'ape'"),
        ("SLatFlowModel", {"num_blocks": None}, "model.json: num_blocks: "),
        ("SLatFlowModel", {"num_blocks": 10**9}, "num_blocks: Input should be less than"),
        ("SLatFlowModel", {"mlp_ratio": math.inf}, "mlp_ratio: Input should be "),
        ("SLatFlowModel", {"mlp_ratio": 1e300}, "mlp_ratio: Input should be "),
        ("SLatFlowModel", {"model_channels": 10**30}, "model_channels: "),
        ("SLatFlowModel", {"io_block_channels": [1] * 10**6}, "io_block_channels: Tuple should"),
    ],
)
def test_wrong_configurations_are_refused_in_a_line(
    name: str, changes: dict[str, Any], said: str
) -> None:
    args = golden_config("slat_flow")["args"] | changes
    with pytest.raises(InputError, match=said) as caught:
        build(name, args, "model.json")
    assert "\n" not in str(caught.value)


def test_arguments_that_are_no_table_are_refused() -> None:
    with pytest.raises(InputError, match=r"model\.json: "):
        build("SLatFlowModel", [1, 2], "model.json")


def test_sizes_that_no_memory_holds() -> None:
    """On the meta device, where files are checked: what overflows is refused, nothing is taken."""
    args = {**golden_config("ss_flow")["args"], "resolution": 65536, "patch_size": 1}
    args |= {"model_channels": 65536, "num_heads": 64}
    with (
        torch.device("meta"),
        pytest.raises(InputError, match=r"model\.json: args: do not describe a valid network"),
    ):
        build("SparseStructureFlowModel", args, "model.json")
    with torch.device("meta"):
        large = build("SparseStructureFlowModel", args | {"resolution": 4096}, "model.json")
    assert large.published_state()["pos_emb"].numel() == 4096**3 * 65536
