"""The published weights that recast knows: where they lie, under which licence, and their pins.

A commit or a hash stands here only if a page of the host itself says it, or if two independent
public projects record it; of torch hub, file names hold the first digits too.
To pin an entry, write the commit that `recast weights list` shows after the first `get` into its
`revision`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import quote

from recast.core.errors import InputError

HUB = "https://huggingface.co"


@dataclass(frozen=True)
class Licence:
    """The terms of a file.

    Attributes:
        name: short name.
        link: address of the terms, or of the page that states them.
        restricted: whether they must be accepted before the first byte: non-commercial, gated, or
            not stated by the publisher.
    """

    name: str
    link: str
    restricted: bool = False


@dataclass(frozen=True)
class WeightsSource:
    """Files that lie in one place.

    Attributes:
        where: "owner/name" of a repository on Hugging Face, or the address of a web folder.
        files: names below it; in a repository also patterns with `*`.
        licence: licence of these files.
        revision: commit of the repository, 40 hexadecimal digits; None takes the main branch at the
            first `get` and keeps its commit in the record.
        sha256: SHA-256 of single files, by name.
        into: subfolder of the weights' folder.
    """

    where: str
    files: tuple[str, ...]
    licence: Licence
    revision: str | None = None
    sha256: Mapping[str, str] = field(default_factory=dict)
    into: str = ""

    @property
    def repository(self) -> bool:
        """Whether it is a repository on Hugging Face."""
        return "://" not in self.where

    @property
    def pinned(self) -> bool:
        """Whether the table fixes the bytes: by the commit, or by the hash of every file."""
        return self.revision is not None or set(self.files) <= set(self.sha256)

    def address(self, file: str, commit: str = "") -> str:
        """Where the publisher has a file, whichever mirror it is fetched from.

        Args:
            commit: commit, for a repository.
        """
        folder = f"{HUB}/{self.where}/resolve/{commit}" if self.repository else self.where
        return f"{folder}/{quote(file, safe='/+')}"


@dataclass(frozen=True)
class Weights:
    """An entry of the table.

    Attributes:
        use: what the networks are for.
        options: command-line options that take the name.
        part: kind of exchangeable part that it names, see `recast.core.plugins.Registry`; or empty.
        gigabytes: size of the download, rounded.
        sources: places where the files lie.
        opens: file or subfolder that stands for the name; the whole folder where empty.
        converter: "module:function" that is called with the folder after the download and writes
            what recast's reader takes.
        converted: downloaded files that are removed after that.
    """

    name: str
    use: str
    options: tuple[str, ...]
    gigabytes: float
    sources: tuple[WeightsSource, ...]
    part: str = ""
    opens: str = ""
    converter: str = ""
    converted: tuple[str, ...] = ()

    @property
    def licences(self) -> tuple[Licence, ...]:
        """The licences of all sources, each once."""
        return tuple(dict.fromkeys(source.licence for source in self.sources))

    @property
    def restricted(self) -> bool:
        """Whether terms must be accepted before the first byte."""
        return any(licence.restricted for licence in self.licences)

    @property
    def pinned(self) -> bool:
        """Whether the table fixes all bytes."""
        return all(source.pinned for source in self.sources)


def published(name: str) -> Weights:
    """The entry of a name.

    Raises:
        InputError: there is none.
    """
    if name not in PUBLISHED:
        known = ", ".join(PUBLISHED)
        raise InputError(
            "weights", name, "is not a name of published weights", f"give one of {known}"
        )
    return PUBLISHED[name]


def _hub_licence(name: str, repository: str, restricted: bool = False) -> Licence:
    return Licence(name, f"{HUB}/{repository}", restricted)


def _apache(repository: str) -> Licence:
    return _hub_licence("Apache-2.0", repository)


_CLIP_LICENCE = Licence("MIT", "https://github.com/openai/CLIP/blob/main/LICENSE")
_TORCHVISION = Licence(
    "BSD-3-Clause (torchvision); trained on ImageNet",
    "https://github.com/pytorch/vision/blob/main/LICENSE",
)
_PYTORCH = "https://download.pytorch.org/models"
_PROCESSOR = ("config.json", "preprocessor_config.json")
_TOKENIZER = ("tokenizer.json", "tokenizer_config.json", "special_tokens_map.json")
_CLIP_FILES = (*_PROCESSOR, *_TOKENIZER, "vocab.json", "merges.txt")
_MODEL = "model.safetensors"
_PICKLE = "pytorch_model.bin"

_TRELLIS_HASHES = {
    "ss_flow_img_dit_L_16l8_fp16": (
        "96dc6bfd4136fd950af564dd16b4ae533c9ba6af8f26c670646b2a9f2789b1db"
    ),
    "slat_flow_img_dit_L_64l8p2_fp16": (
        "693fb2a58ad497bd222007301eeec49d14d60f8c12d2f2f00c221fa747b4c66c"
    ),
    "ss_dec_conv3d_16l8_fp16": "1c76d4a40519aa2d711cc263a8404105231ac26db31d946bed48b84fee79009a",
    "slat_dec_gs_swin8_B_64l8gs32_fp16": (
        "38c84bcef5ce0af1f48b1b5558dabc7575a13346043c41a7e0610f1fa619a161"
    ),
    "ss_enc_conv3d_16l8_fp16": "107874eeaa0feb82f51b19db5da7db534fb7e7f19e5a122b9ff1bc2e258bfc6d",
    "slat_enc_swin8_B_64l8_fp16": (
        "21dceac6bee917ab6458ff52c9757ba89a779d03031c7bd17f9e7f0103bfd436"
    ),
}
"""Of the six networks that recast loads, by stem below ckpts/."""

_TRELLIS = WeightsSource(
    "microsoft/TRELLIS-image-large",
    (
        "pipeline.json",
        *(f"ckpts/{stem}.{kind}" for stem in _TRELLIS_HASHES for kind in ("json", "safetensors")),
    ),
    _hub_licence("MIT", "microsoft/TRELLIS-image-large"),
    revision="25e0d31ffbebe4b5a97464dd851910efc3002d96",
    sha256={f"ckpts/{stem}.safetensors": sha256 for stem, sha256 in _TRELLIS_HASHES.items()},
)


def _dinov2(into: str = "") -> WeightsSource:
    return WeightsSource(
        "facebook/dinov2-with-registers-large",
        (*_PROCESSOR, _MODEL),
        _apache("facebook/dinov2-with-registers-large"),
        revision="e4c89a4e05589de9b3e188688a303d0f3c04d0f3",
        into=into,
    )


def _grounding_dino(size: str, revision: str, sha256: str) -> WeightsSource:
    repository = f"IDEA-Research/grounding-dino-{size}"
    return WeightsSource(
        repository,
        (*_PROCESSOR, *_TOKENIZER, "vocab.txt", _MODEL),
        _apache(repository),
        revision,
        {_MODEL: sha256},
        "grounding-dino",
    )


def _sam(size: str, revision: str, sha256: Mapping[str, str]) -> WeightsSource:
    repository = f"facebook/sam-vit-{size}"
    return WeightsSource(
        repository, (*_PROCESSOR, _MODEL), _apache(repository), revision, sha256, "sam"
    )


def _flant5(size: str, revision: str | None) -> WeightsSource:
    repository = f"zhiqiulin/clip-flant5-{size}"
    return WeightsSource(
        repository,
        ("config.json", *_TOKENIZER, "spiece.model", "pytorch_model*"),
        _apache(repository),
        revision,
    )


def _one_file(
    name: str,
    use: str,
    option: str,
    gigabytes: float,
    licence: Licence,
    address: str,
    sha256: str,
) -> Weights:
    """An entry that is the one file of an address, which stands for the name."""
    folder, _, file = address.rpartition("/")
    source = WeightsSource(folder, (file,), licence, sha256={file: sha256})
    return Weights(name, use, (option,), gigabytes, (source,), opens=file)


_VISION_TOWER = WeightsSource(
    "openai/clip-vit-large-patch14-336",
    _PROCESSOR,
    _CLIP_LICENCE,
    revision="ce19dc912ca5cd21c8a653c79e251e808ccabcd1",
    into="vision_tower",
)
"""How CLIP-FlanT5's vision tower takes pictures; its weights are among those of the network."""

_TABLE = (
    Weights(
        "trellis",
        "one image to a vehicle: TRELLIS-image-large with DINOv2",
        ("--generator", "--model"),
        4.2,
        (_TRELLIS, _dinov2("dinov2")),
        "generator",
    ),
    Weights(
        "dinov2",
        "image encoder of TRELLIS; feature distance: DINOv2 ViT-L/14 with registers",
        ("--image-encoder", "--dino"),
        1.2,
        (_dinov2(),),
    ),
    Weights(
        "grounded-sam",
        "segmentation: Grounding DINO base with SAM ViT-H",
        ("--segmenter",),
        3.5,
        (
            _grounding_dino(
                "base",
                "12bdfa3120f3e7ec7b434d90674b3396eccf88eb",
                "5548f844c928c4b6f411fa8cbcc2bfa8dbbba437cb1d513975519f93c2a9ed21",
            ),
            _sam("huge", "87aecf0df4ce6b30cd7de76e87673c49644bdf67", {}),
        ),
        "segmenter",
    ),
    Weights(
        "grounded-sam-small",
        "segmentation: Grounding DINO tiny with SAM ViT-B",
        ("--segmenter",),
        1.1,
        (
            _grounding_dino(
                "tiny",
                "a2bb814dd30d776dcf7e30523b00659f4f141c71",
                "1a2412ef99bd74bcd3c2a246fa1e48581f8889a1300c9051974741314fc042f3",
            ),
            _sam(
                "base",
                "70c1a07f894ebb5b307fd9eaaee97b9dfc16068f",
                {_MODEL: "892c410e496344e527255ccdcb2cb7244a609acb5389c7c4fdba1288f861c579"},
            ),
        ),
        "segmenter",
    ),
    Weights(
        "clip-vit-l14",
        "image and text similarity, aesthetic score: CLIP ViT-L/14",
        ("--clip",),
        1.7,
        (
            WeightsSource(
                "openai/clip-vit-large-patch14",
                (*_CLIP_FILES, _MODEL),
                _CLIP_LICENCE,
                "32bd64288804d66eefd0ccbe215aa642df71cc41",
                {_MODEL: "a2bf730a0c7debf160f7a6b50b3aaf3703e7e88ac73de7a314903141db026dcb"},
            ),
        ),
    ),
    Weights(
        "clip-vit-b32",
        "image and text similarity: CLIP ViT-B/32",
        ("--clip",),
        0.6,
        (
            WeightsSource(
                "openai/clip-vit-base-patch32",
                (*_CLIP_FILES, _PICKLE),
                _CLIP_LICENCE,
                "3d74acf9a28c67741b2f4f2ea7635f0aaf6f0268",
                {_PICKLE: "a63082132ba4f97a80bea76823f544493bffa8082296d62d71581a4feff1576f"},
            ),
        ),
        converter="recast.weights.fetch:safetensors_of_pickle",
        converted=(_PICKLE,),
    ),
    Weights(
        "clip-flant5-xxl",
        "VQAScore: CLIP-FlanT5 XXL",
        ("--vqa",),
        22.9,
        (_flant5("xxl", None), _VISION_TOWER),
        "VQA scorer",
    ),
    Weights(
        "clip-flant5-xl",
        "VQAScore: CLIP-FlanT5 XL",
        ("--vqa",),
        6.3,
        (_flant5("xl", "2cee5afb3386792d9b21066a89232687dfce2c62"), _VISION_TOWER),
        "VQA scorer",
    ),
    _one_file(
        "alexnet",
        "LPIPS: AlexNet",
        "--lpips-weights",
        0.2,
        _TORCHVISION,
        f"{_PYTORCH}/alexnet-owt-7be5be79.pth",
        "7be5be791159472b1fbf3c69796f7cb30dca7ad8466c2df70058c37116cdee02",
    ),
    _one_file(
        "vgg16",
        "LPIPS: VGG-16",
        "--lpips-weights",
        0.6,
        _TORCHVISION,
        f"{_PYTORCH}/vgg16-397923af.pth",
        "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0",
    ),
    _one_file(
        "inception",
        "Frechet distance: the FID's Inception v3",
        "--inception",
        0.1,
        Licence("Apache-2.0", "https://github.com/mseitzer/pytorch-fid/blob/master/LICENSE"),
        "https://github.com/mseitzer/pytorch-fid/releases/download/fid_weights/"
        "pt_inception-2015-12-05-6726825d.pth",
        "6726825d0af5f729cebd5821db510b11b1cfad8faad88a03f1befd49fb9129b2",
    ),
    Weights(
        "gtrs-dense",
        "planner: GTRS-Dense with V2-99 and 8192 trajectories",
        ("--planner",),
        0.9,
        (
            WeightsSource(
                "Zzxxxxxxxx/gtrs",
                ("gtrs_dense_vov.ckpt",),
                _hub_licence(
                    "not stated for the weights (code Apache-2.0); trained on nuPlan, whose terms "
                    "are non-commercial",
                    "Zzxxxxxxxx/gtrs",
                    restricted=True,
                ),
            ),
            WeightsSource(
                "https://raw.githubusercontent.com/NVlabs/GTRS/"
                "92a740def80610e4096962d25cc837b21e72ef78/traj_final",
                ("8192.npy",),
                Licence("Apache-2.0", "https://github.com/NVlabs/GTRS"),
                sha256={
                    "8192.npy": "cc44a31e75a53406db59f026f0358de97931e726f10254542f98d2a87a38ad35"
                },
            ),
        ),
        part="planner",
        opens="planner",
        converter="recast.planning.gtrs.folder:convert_release",
        converted=("gtrs_dense_vov.ckpt", "8192.npy"),
    ),
    _one_file(
        "aesthetic",
        "aesthetic score of targets: Improved Aesthetic Predictor",
        "--predictor",
        0.004,
        Licence("Apache-2.0", "https://github.com/christophschuhmann/improved-aesthetic-predictor"),
        "https://raw.githubusercontent.com/christophschuhmann/"
        "improved-aesthetic-predictor/6934dd81792f086e613a121dbce43082cb8be85e/"
        "sac+logos+ava1-l14-linearMSE.pth",
        "21dd590f3ccdc646f0d53120778b296013b096a035a2718c9cb0d511bff0f1e0",
    ),
)

PUBLISHED: Mapping[str, Weights] = {one.name: one for one in _TABLE}
"""All entries by name."""
