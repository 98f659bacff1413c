"""Image metrics and the two baselines that a network has to beat.

SPDX-License-Identifier: BSD-3-Clause

psnr(), ssim() and l1() take linear radiance and compare what a person sees: sRGB, clipped to [0, 1]. rel_mse() compares
linear radiance. All take (C, H, W) or (B, C, H, W) and give one number an image, in float64.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch

from pave.errors import UsageError
from pave.schema import TARGET, Sample
from pave.transfer import to_display

SSIM_SIGMA = 1.5  # Wang et al. 2004
SSIM_RADIUS = 5
SSIM_K1, SSIM_K2 = 0.01, 0.03
REL_MSE_EPSILON = 1e-2  # keeps black pixels from counting without bound (Rousselle et al. 2011)


def check_size(width: int, height: int) -> None:
    """Raises UsageError for images that SSIM cannot compare, before any work is done on them."""
    if min(width, height) <= 2 * SSIM_RADIUS:
        side = 2 * SSIM_RADIUS + 1
        raise UsageError(
            f"images of {width}x{height} pixels are too small: SSIM compares windows of {side}x{side}"
        )


def psnr(ours: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Peak signal to noise ratio in dB; +inf for equal images."""
    return display_psnr(to_display(ours), to_display(truth))


def ssim(ours: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Structural similarity, mean over channels and over the pixels whose window lies in the image."""
    return display_ssim(to_display(ours), to_display(truth))


def l1(ours: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Mean absolute difference."""
    return display_l1(to_display(ours), to_display(truth))


def rel_mse(ours: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Mean of squared error over squared truth, of linear radiance."""
    ours, truth = ours.double(), truth.double()
    return ((ours - truth) ** 2 / (truth**2 + REL_MSE_EPSILON)).mean((-3, -2, -1))


def compare(ours: torch.Tensor, truth: torch.Tensor) -> dict[str, torch.Tensor]:
    """All four by name, for less than the sum of their costs."""
    shown, aim = to_display(ours), to_display(truth)
    return {
        "psnr": display_psnr(shown, aim),
        "ssim": display_ssim(shown, aim),
        "l1": display_l1(shown, aim),
        "rel_mse": rel_mse(ours, truth),
    }


def display_l1(ours: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """l1() of images that are already in [0, 1]."""
    return (ours.double() - truth.double()).abs().mean((-3, -2, -1))


def display_psnr(ours: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """psnr() of images that are already in [0, 1]."""
    mse = (ours.double() - truth.double()).square().mean((-3, -2, -1))
    return -10 * mse.log10()


def display_ssim(ours: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """ssim() of images that are already in [0, 1]: Gaussian window, population covariance (Wang et al. 2004)."""
    single = ours.dim() == 3
    if single:
        ours, truth = ours[None], truth[None]
    check_size(ours.shape[-1], ours.shape[-2])
    x, y = ours.double().flatten(0, 1)[:, None], truth.double().flatten(0, 1)[:, None]
    mean_x, mean_y = _blur(x), _blur(y)
    variance_x = _blur(x * x) - mean_x**2
    variance_y = _blur(y * y) - mean_y**2
    covariance = _blur(x * y) - mean_x * mean_y
    c1, c2 = SSIM_K1**2, SSIM_K2**2
    similarity = ((2 * mean_x * mean_y + c1) * (2 * covariance + c2)) / (
        (mean_x**2 + mean_y**2 + c1) * (variance_x + variance_y + c2)
    )
    values = similarity.mean((1, 2, 3)).view(ours.shape[0], -1).mean(1)
    return values[0] if single else values


def _blur(x: torch.Tensor) -> torch.Tensor:
    """Gaussian window over rows, then columns. Sums of shifted slices: six times faster in float64 than convolutions."""
    offsets = torch.arange(-SSIM_RADIUS, SSIM_RADIUS + 1, dtype=torch.float64)
    window = torch.exp(-0.5 * (offsets / SSIM_SIGMA) ** 2)
    window = window / window.sum()
    for axis in (-2, -1):
        size = x.shape[axis] - 2 * SSIM_RADIUS
        blurred = torch.zeros_like(x.narrow(axis, 0, size))
        for start, weight in enumerate(window.tolist()):
            blurred.add_(x.narrow(axis, start, size), alpha=weight)
        x = blurred
    return x


class AmbientFit:
    """Least squares for the constant k (one a colour) in color = direct + k * albedo, in linear radiance.

    Radiance above 1 shows as white whatever it is, so those pixels do not count.
    """

    def __init__(self, planes: int = 3) -> None:
        self.numerator = torch.zeros(planes, dtype=torch.float64)
        self.denominator = torch.zeros(planes, dtype=torch.float64)

    def add(self, sample: Sample) -> None:
        color, direct, albedo = (sample[name].double() for name in (TARGET, "direct", "albedo"))
        albedo = albedo * (color <= 1.0)
        self.numerator += (
            (albedo * (color - direct)).sum((-2, -1)).view(-1, len(self.numerator)).sum(0)
        )
        self.denominator += (albedo * albedo).sum((-2, -1)).view(-1, len(self.numerator)).sum(0)

    @property
    def ambient(self) -> torch.Tensor:
        """k, (planes,) float32; 0 where nothing was seen."""
        return (self.numerator / self.denominator.clamp_min(1e-12)).float()


def fit_ambient(samples: Iterable[Sample]) -> torch.Tensor:
    """The constant ambient of the second baseline, over the training split."""
    fit = AmbientFit()
    for sample in samples:
        fit.add(sample)
    return fit.ambient


def with_ambient(sample: Sample, ambient: torch.Tensor) -> torch.Tensor:
    """The second baseline: direct + k * albedo."""
    return sample["direct"] + ambient.view(-1, 1, 1) * sample["albedo"]
