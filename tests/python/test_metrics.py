"""Metrics against scikit-image and by hand, and the baselines.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from training_data import make_sample, make_samples

from pave import metrics
from pave.errors import UsageError


def images(seed: int, height: int = 37, width: int = 52) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    truth = torch.nn.functional.avg_pool2d(
        torch.rand(3, height + 4, width + 4, generator=generator), 5, 1
    )
    noise = 0.1 * torch.randn(truth.shape, generator=generator)
    return (truth + noise).clamp(0, 1), truth


@pytest.mark.parametrize("seed", range(4))
def test_equal_to_scikit_image(seed: int) -> None:
    ours, truth = images(seed)
    a, b = (t.permute(1, 2, 0).double().numpy() for t in (ours, truth))
    expected = structural_similarity(
        a,
        b,
        data_range=1.0,
        channel_axis=2,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    assert float(metrics.display_ssim(ours, truth)) == pytest.approx(expected, abs=1e-6)
    expected = peak_signal_noise_ratio(b, a, data_range=1.0)
    assert float(metrics.display_psnr(ours, truth)) == pytest.approx(expected, abs=1e-6)


def test_identical_images() -> None:
    color = make_sample(0)["color"]
    assert math.isinf(float(metrics.psnr(color, color)))
    assert float(metrics.ssim(color, color)) == pytest.approx(1.0, abs=1e-12)
    assert float(metrics.l1(color, color)) == 0.0
    assert float(metrics.rel_mse(color, color)) == 0.0


def test_compares_what_is_shown() -> None:
    """Radiance above 1 is white on any screen: no metric but rel_mse may see how far above."""
    truth = torch.full((3, 16, 16), 5.0)
    assert float(metrics.l1(truth * 3, truth)) == 0.0
    assert math.isinf(float(metrics.psnr(truth * 3, truth)))
    assert float(metrics.rel_mse(truth * 3, truth)) == pytest.approx(100 / 25.01, rel=1e-6)
    # sRGB of 0.2 and 0.3 by the standard's formula.
    a, b = torch.full((3, 16, 16), 0.2), torch.full((3, 16, 16), 0.3)
    step = 1.055 * (0.3 ** (1 / 2.4) - 0.2 ** (1 / 2.4))
    assert float(metrics.l1(a, b)) == pytest.approx(step, rel=1e-6)
    assert float(metrics.psnr(a, b)) == pytest.approx(-20 * math.log10(step), abs=1e-4)


def test_batches_are_single_images() -> None:
    pairs = [images(seed) for seed in range(3)]
    ours, truth = (torch.stack(list(side)) for side in zip(*pairs, strict=True))
    for function in (metrics.psnr, metrics.ssim, metrics.l1, metrics.rel_mse):
        batch = function(ours, truth)
        assert batch.shape == (3,)
        for value, (a, b) in zip(batch, pairs, strict=True):
            assert float(value) == pytest.approx(float(function(a, b)), rel=1e-9)


def test_ssim_refuses_images_without_a_whole_window() -> None:
    with pytest.raises(UsageError, match="64x10 pixels are too small"):
        metrics.ssim(torch.zeros(3, 10, 64), torch.zeros(3, 10, 64))


def test_ambient_is_the_least_squares_constant() -> None:
    samples = make_samples(5)
    ambient = metrics.fit_ambient(samples)
    for plane in range(3):
        a, b = [], []
        for sample in samples:
            shown = (sample["color"][plane] <= 1).flatten().numpy()
            a.append(sample["albedo"][plane].flatten().numpy()[shown])
            b.append((sample["color"] - sample["direct"])[plane].flatten().numpy()[shown])
        (expected,), *_ = np.linalg.lstsq(np.concatenate(a)[:, None], np.concatenate(b), rcond=None)
        assert float(ambient[plane]) == pytest.approx(float(expected), rel=1e-4)
    sample = samples[0]
    better = metrics.psnr(metrics.with_ambient(sample, ambient), sample["color"])
    assert float(better) > float(metrics.psnr(sample["direct"], sample["color"])) + 1
    batch = {name: torch.stack([s[name] for s in samples]) for name in samples[0]}
    assert torch.allclose(metrics.fit_ambient([batch]), ambient, rtol=1e-5)
