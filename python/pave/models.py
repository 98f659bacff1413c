"""The conditional GAN: a U-Net that draws an image from the buffers, and a PatchGAN that judges buffers and image.

SPDX-License-Identifier: BSD-3-Clause

The only definition of the network: export.py traces these modules into the graph that host/nn executes, so they use no
operation that is not in export.OPS.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from pave.errors import UsageError

NORMS = ("batch", "instance", "none")
HEADS = ("sigmoid", "residual")
MAX_WIDENING = 8  # no layer has more than this times the first layer's filters
LEAK = 0.2


@dataclass(frozen=True)
class GeneratorOptions:
    """Shape of the U-Net. `head`: "sigmoid" is the papers' network, whose last transposed convolution makes the image;
    "residual" refines at full resolution with the buffers at hand and adds to the encoded `direct` buffer."""

    filters: int = 24
    unet_depth: int = 5
    norm: str = "none"
    head: str = "residual"
    refine: int = 1  # 3x3 convolutions at full resolution before the last one; residual head only

    def check(self) -> None:
        """Raises UsageError for what makes no network."""
        if not 1 <= self.filters <= 1024:
            raise UsageError(f"filters {self.filters} is outside 1..1024")
        if not 1 <= self.unet_depth <= 10:
            raise UsageError(f"unet_depth {self.unet_depth} is outside 1..10")
        if self.norm not in NORMS:
            raise UsageError(f"norm '{self.norm}' is not one of {', '.join(NORMS)}")
        if self.head not in HEADS:
            raise UsageError(f"head '{self.head}' is not one of {', '.join(HEADS)}")
        if not 0 <= self.refine <= 8:
            raise UsageError(f"refine {self.refine} is outside 0..8")


def make_norm(kind: str, planes: int) -> nn.Module | None:
    """A normalisation of the layer's own; shared ones mix the statistics of layers that have nothing in common."""
    if kind == "batch":
        return nn.BatchNorm2d(planes)
    if kind == "instance":
        return nn.InstanceNorm2d(planes, affine=True)
    return None


class Layer(nn.Module):
    """Convolution, normalisation if any, activation if any."""

    def __init__(self, conv: nn.Module, norm: nn.Module | None, activation: nn.Module | None):
        super().__init__()
        self.conv = conv
        self.norm = norm
        self.activation = activation

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = self.conv(x)
        if self.norm is not None:
            x = self.norm(x)
        return x if self.activation is None else self.activation(x)


def halve(planes: int, filters: int, norm: str) -> Layer:
    """Half the resolution."""
    module = make_norm(norm, filters)
    conv = nn.Conv2d(planes, filters, 4, stride=2, padding=1, bias=module is None)
    return Layer(conv, module, nn.LeakyReLU(LEAK))


def double(planes: int, filters: int, norm: str) -> Layer:
    """Twice the resolution."""
    module = make_norm(norm, filters)
    conv = nn.ConvTranspose2d(planes, filters, 4, stride=2, padding=1, bias=module is None)
    return Layer(conv, module, nn.LeakyReLU(LEAK))


def keep(planes: int, filters: int, norm: str) -> Layer:
    """The same resolution."""
    module = make_norm(norm, filters)
    conv = nn.Conv2d(planes, filters, 3, padding=1, bias=module is None)
    return Layer(conv, module, nn.LeakyReLU(LEAK))


class Generator(nn.Module):
    """U-Net from encoded buffers (B, in_planes, H, W) to the encoded image (B, out_planes, H, W).

    H and W are multiples of `multiple`. `direct_first` is the plane of the input at which `direct` begins; the residual
    head adds to it.
    """

    def __init__(
        self,
        in_planes: int,
        options: GeneratorOptions,
        out_planes: int = 3,
        direct_first: int | None = None,
    ):
        super().__init__()
        options.check()
        if options.head == "residual" and direct_first is None:
            raise UsageError("head 'residual' adds to the channel 'direct': name it in the inputs")
        self.direct_first, self.out_planes = direct_first, out_planes
        self.residual = options.head == "residual"
        widths = [
            options.filters * min(2**level, MAX_WIDENING) for level in range(options.unet_depth)
        ]
        planes = [in_planes, *widths]
        # The outermost layer sees raw buffers and the innermost may be a single pixel: neither has statistics to normalise.
        innermost = options.unet_depth - 1
        self.encode = nn.ModuleList(
            halve(planes[i], widths[i], options.norm if 0 < i < innermost else "none")
            for i in range(options.unet_depth)
        )
        self.decode = nn.ModuleList(
            double(widths[i] * (1 if i == innermost else 2), widths[i - 1], options.norm)
            for i in range(innermost, 0, -1)
        )
        inner = widths[0] * (1 if options.unet_depth == 1 else 2)
        if self.residual:
            # Half the filters, as planes here cost four times what they cost one level below; a multiple of 8, as convolutions
            # work on blocks of 8 planes.
            width = 8 * -(-options.filters // 16)
            self.decode.append(double(inner, width, options.norm))
            sizes = [width + in_planes, *[width] * options.refine]
            self.refine = nn.ModuleList(
                keep(sizes[i], sizes[i + 1], "none") for i in range(options.refine)
            )
            self.last = nn.Conv2d(sizes[-1], out_planes, 3, padding=1)
        else:
            self.last = nn.ConvTranspose2d(inner, out_planes, 4, stride=2, padding=1)
            self.squash = nn.Sigmoid()
        self.multiple = 2**options.unet_depth
        self._initialise()

    def _initialise(self) -> None:
        """He et al. 2015 for the leak; the last layer starts small, so that a residual starts as its baseline."""
        for module in self.modules():
            if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d)):
                nn.init.kaiming_normal_(module.weight, a=LEAK, mode="fan_in")
                if isinstance(module, nn.ConvTranspose2d):
                    # torch counts all taps; with stride 2 only a quarter of them meet a pixel, and dim 1 is the outputs.
                    taps = module.weight[0, 0].numel() / 4
                    gain = nn.init.calculate_gain("leaky_relu", LEAK)
                    nn.init.normal_(module.weight, 0.0, gain / (module.in_channels * taps) ** 0.5)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        with torch.no_grad():
            self.last.weight.mul_(0.1)

    def forward(self, buffers: torch.Tensor) -> torch.Tensor:
        skips = []
        x = buffers
        for layer in self.encode:
            x = layer(x)
            skips.append(x)
        skips.pop()
        for layer in self.decode:
            x = layer(x)
            if skips:
                x = torch.cat([x, skips.pop()], 1)
        if not self.residual:
            return self.squash(self.last(x))
        x = torch.cat([x, buffers], 1)
        for layer in self.refine:
            x = layer(x)
        first = self.direct_first
        return self.last(x) + buffers[:, first : first + self.out_planes]


class Discriminator(nn.Module):
    """PatchGAN: encoded buffers and an encoded image -> one logit a patch; their mean is the verdict."""

    def __init__(self, in_planes: int, filters: int, layers: int, norm: str):
        super().__init__()
        if not 1 <= filters <= 1024 or not 1 <= layers <= 6:
            raise UsageError(f"d_filters {filters} or d_layers {layers} is outside 1..1024, 1..6")
        widths = [filters * min(2**level, MAX_WIDENING) for level in range(layers)]
        planes = [in_planes, *widths]
        self.layers = nn.Sequential(
            *(halve(planes[i], widths[i], norm if i > 0 else "none") for i in range(layers)),
            keep(widths[-1], widths[-1], norm),
            nn.Conv2d(widths[-1], 1, 3, padding=1),
        )
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, a=LEAK)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)

    def forward(self, buffers: torch.Tensor, image: torch.Tensor) -> torch.Tensor:
        return self.layers(torch.cat([buffers, image], 1))
