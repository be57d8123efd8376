"""The image backbone: VoVNetV2 with effective squeeze-excitation in every block.

Module names, with their slashes, are those of the released checkpoints. They differ from timm's
`ese_vovnet`, which has the eSE in the last block of each stage only and is not equivalent.
"""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import Tensor, nn
from torch.nn import functional

from recast.planning.gtrs.config import BackboneConfig


class _FrozenBatchNorm(nn.BatchNorm2d):
    """A batch norm that always uses its running statistics; scale and shift are trainable."""

    def train(self, mode: bool = True) -> _FrozenBatchNorm:
        return super().train(False)


class _Chain(nn.Sequential):
    """Modules one after the other; in inference, a norm is folded into the convolution before it.

    That saves two passes over the features. The folded weights are computed anew each time, which
    costs nothing beside the convolution: so there is one set of weights, to be trained, saved and
    replaced, and nothing that could be out of date.
    """

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to what the last module gives."""
        modules = list(self)
        if torch.is_grad_enabled() or any(module.training for module in modules):
            for module in modules:
                x = module(x)
            return x
        for module, following in zip(modules, [*modules[1:], None], strict=True):
            if isinstance(module, nn.Conv2d) and isinstance(following, nn.BatchNorm2d):
                x = _folded(module, following, x)
            elif isinstance(module, nn.ReLU):
                x = x.relu_()  # always behind a convolution, whose output nobody else holds
            elif not isinstance(module, nn.BatchNorm2d):
                x = module(x)
        return x


def _folded(conv: nn.Conv2d, norm: nn.BatchNorm2d, x: Tensor) -> Tensor:
    """`norm(conv(x))` with running statistics, as one convolution."""
    assert norm.running_mean is not None and norm.running_var is not None
    scale = norm.weight * torch.rsqrt(norm.running_var + norm.eps)
    shift = norm.bias - norm.running_mean * scale
    weight = conv.weight * scale[:, None, None, None]
    return functional.conv2d(x, weight, shift, conv.stride, conv.padding)


class _Blocks:
    """Builds the convolutions of one backbone."""

    def __init__(self, frozen_norm: bool) -> None:
        self.norm: type[nn.BatchNorm2d] = _FrozenBatchNorm if frozen_norm else nn.BatchNorm2d

    def conv(self, name: str, inputs: int, outputs: int, kernel: int, stride: int = 1) -> nn.Module:
        """Convolution, batch norm and ReLU as `<name>/conv`, `<name>/norm`, `<name>/relu`."""
        parts: OrderedDict[str, nn.Module] = OrderedDict()
        parts[f"{name}/conv"] = nn.Conv2d(
            inputs, outputs, kernel, stride, padding=kernel // 2, bias=False
        )
        parts[f"{name}/norm"] = self.norm(outputs)
        parts[f"{name}/relu"] = nn.ReLU()
        return _Chain(parts)


class EffectiveSqueezeExcitation(nn.Module):
    """Channel weights from the mean over the image: y * relu6(fc(mean y) + 3) / 6."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.fc = nn.Conv2d(channels, channels, 1)

    def forward(self, y: Tensor) -> Tensor:
        """(B, C, H, W) to the same shape."""
        return y * functional.hardsigmoid(self.fc(y.mean((2, 3), keepdim=True)))


class AggregationBlock(nn.Module):
    """One-shot aggregation: a chain of 3x3 convolutions, all kept, mixed once by a 1x1."""

    def __init__(
        self,
        build: _Blocks,
        name: str,
        inputs: int,
        channels: int,
        outputs: int,
        layers: int,
        residual: bool,
    ) -> None:
        super().__init__()
        self.residual = residual
        self.layers = nn.ModuleList(
            build.conv(f"{name}_{i}", channels if i else inputs, channels, 3) for i in range(layers)
        )
        self.concat = build.conv(f"{name}_concat", inputs + layers * channels, outputs, 1)
        self.ese = EffectiveSqueezeExcitation(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H, W)."""
        features = [x]
        for layer in self.layers:
            features.append(layer(features[-1]))
        y: Tensor = self.ese(self.concat(torch.cat(features, dim=1)))
        return y + x if self.residual else y


class VovNet(nn.Module):
    """The backbone of a `BackboneConfig`.

    Source: Lee and Park, CenterMask (2020), as used by GTRS: eSE in every block, all blocks of a
    stage but the first residual, pools 3x3 of stride 2 without padding that round up.
    """

    def __init__(self, config: BackboneConfig) -> None:
        super().__init__()
        build = _Blocks(config.frozen_norm)
        stem, inputs = OrderedDict[str, nn.Module](), 3
        for i, (channels, stride) in enumerate(zip(config.stem, (2, 1, 2), strict=True), start=1):
            stem.update(build.conv(f"stem_{i}", inputs, channels, 3, stride).named_children())
            inputs = channels
        self.stem = _Chain(stem)
        self.stage_names: list[str] = []
        for number, stage in enumerate(config.stages, start=2):
            parts = OrderedDict[str, nn.Module]()
            if number > 2:
                parts["Pooling"] = nn.MaxPool2d(3, 2, ceil_mode=True)
            for block in range(1, stage.blocks + 1):
                name = f"OSA{number}_{block}"
                parts[name] = AggregationBlock(
                    build, name, inputs, stage.conv_channels, stage.out_channels, config.layers,
                    residual=block > 1,
                )  # fmt: skip
                inputs = stage.out_channels
            self.stage_names.append(f"stage{number}")
            self.add_module(f"stage{number}", nn.Sequential(parts))

    def stages(self, images: Tensor) -> list[Tensor]:
        """Features of every stage, finest first.

        Args:
            images: (B, 3, H, W) RGB in [0, 1], not normalised.

        Returns:
            tensors (B, C_s, H_s, W_s) at strides 4, 8, ...; the pools round sizes up.
        """
        x = self.stem(images.flip(1))  # the weights were trained on BGR
        features = []
        for name in self.stage_names:
            x = self.get_submodule(name)(x)
            features.append(x)
        return features

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, H, W) RGB in [0, 1] to the last stage's features; see `stages`."""
        return self.stages(images)[-1]
