"""The one transfer function between linear radiance and the network's numbers, and the encodings of the other buffers.

SPDX-License-Identifier: BSD-3-Clause

host/nn implements the same formulas in OpenCL from the numbers in generator.json; test_transfer holds both to the laws
`decode(encode(x)) == x` and monotony. Nothing here depends on one image: the scales are fixed for a whole run.
"""

from __future__ import annotations

import math

import torch

NAME = "srgb_log"  # transfer.name in generator.json

LINEAR_END = 0.0031308  # IEC 61966-2-1: below it sRGB is linear
LINEAR_SLOPE = 12.92
# Slope of the sRGB curve at 1: the logarithm goes on from there with the same value and slope.
LOG_SLOPE = 1.055 / 2.4


def compress(x: torch.Tensor) -> torch.Tensor:
    """f: linear radiance -> sRGB below 1, logarithm above. Negative values count as 0."""
    x = x.clamp_min(0.0)
    low = LINEAR_SLOPE * x
    mid = 1.055 * x.clamp(LINEAR_END, 1.0).pow(1 / 2.4) - 0.055
    high = 1.0 + LOG_SLOPE * x.clamp_min(1.0).log()
    return torch.where(x <= LINEAR_END, low, torch.where(x <= 1.0, mid, high))


def expand(y: torch.Tensor) -> torch.Tensor:
    """Inverse of compress()."""
    y = y.clamp_min(0.0)
    low = y / LINEAR_SLOPE
    mid = ((y.clamp(LINEAR_SLOPE * LINEAR_END, 1.0) + 0.055) / 1.055).pow(2.4)
    high = ((y.clamp_min(1.0) - 1.0) / LOG_SLOPE).exp()
    return torch.where(y <= LINEAR_SLOPE * LINEAR_END, low, torch.where(y <= 1.0, mid, high))


def compressed_peak(peak: float) -> float:
    """f(peak) for peak >= 1: what compressed radiance is divided by."""
    return 1.0 + LOG_SLOPE * math.log(max(peak, 1.0))


def encode_radiance(x: torch.Tensor, peak: float) -> torch.Tensor:
    """Linear radiance -> about [0, 1]; `peak` becomes 1 and what is brighter goes on above 1."""
    return compress(x) / compressed_peak(peak)


def decode_radiance(y: torch.Tensor, peak: float) -> torch.Tensor:
    """Inverse of encode_radiance()."""
    return expand(y * compressed_peak(peak))


def encode_depth(depth: torch.Tensor, scale: float) -> torch.Tensor:
    """Depth in scene units -> (0, 1], near is 1 and a miss (+inf) is 0."""
    return scale / (scale + depth.clamp_min(0.0))


def decode_depth(y: torch.Tensor, scale: float) -> torch.Tensor:
    """Inverse of encode_depth()."""
    return scale / y - scale


def encode_position(position: torch.Tensor, center: list[float], radius: float) -> torch.Tensor:
    """World position (..., 3, H, W) -> the scene's bounding sphere scaled to the unit sphere."""
    middle = torch.as_tensor(center, dtype=position.dtype, device=position.device)
    return (position - middle.view(3, 1, 1)) / radius


def decode_position(y: torch.Tensor, center: list[float], radius: float) -> torch.Tensor:
    """Inverse of encode_position()."""
    middle = torch.as_tensor(center, dtype=y.dtype, device=y.device)
    return y * radius + middle.view(3, 1, 1)


def to_display(linear: torch.Tensor) -> torch.Tensor:
    """Linear radiance -> sRGB in [0, 1], clipped: what images are compared in and shown as."""
    return compress(linear.clamp(0.0, 1.0))
