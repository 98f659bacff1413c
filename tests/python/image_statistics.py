"""Tests whether two Monte Carlo images can have the same expected value, by means and variances.

SPDX-License-Identifier: BSD-3-Clause

The per-pixel test is that of Mitsuba's own test_renders.py (two-sided z-test, alpha 0.01 with
Sidak's correction for the number of tests), here between two estimates of known variance. An image
mean and block means see smaller and smoother faults than single pixels can.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from statistics import NormalDist

import numpy as np
import scipy.stats

# float32 sums: two exact images of one constant may differ by this much of it.
RELATIVE_FLOOR = 2e-5
ABSOLUTE_FLOOR = 1e-6


@dataclass(frozen=True)
class Estimate:
    """An image as (H, W, C) and the variance of each of its values."""

    mean: np.ndarray
    variance: np.ndarray

    @classmethod
    def of_runs(cls, runs: list[np.ndarray]) -> Estimate:
        """The mean of independent images of equal sample counts, and that mean's variance."""
        stack = np.stack(runs).astype(np.float64)
        return cls(stack.mean(axis=0), stack.var(axis=0, ddof=1) / len(runs))

    def whole(self) -> Estimate:
        """The mean over all pixels, as an image of one."""
        pixels = self.mean[..., 0].size
        return Estimate(
            self.mean.astype(np.float64).mean(axis=(0, 1), keepdims=True),
            self.variance.astype(np.float64).sum(axis=(0, 1), keepdims=True) / pixels**2,
        )

    def blocks(self, size: int) -> Estimate:
        """Means over size x size pixels; a rest at the right and the bottom is left out."""
        height, width, planes = self.mean.shape
        rows, columns = height // size, width // size

        def sums(image: np.ndarray) -> np.ndarray:
            cut = image[: rows * size, : columns * size].astype(np.float64)
            return cut.reshape(rows, size, columns, size, planes).sum(axis=(1, 3))

        return Estimate(sums(self.mean) / size**2, sums(self.variance) / size**4)


def z_scores(a: Estimate, b: Estimate) -> np.ndarray:
    """Differences in standard deviations."""
    floor = RELATIVE_FLOOR * np.maximum(np.abs(a.mean), np.abs(b.mean)) + ABSOLUTE_FLOOR
    deviation = np.sqrt(a.variance.astype(np.float64) + b.variance + floor**2)
    return (a.mean.astype(np.float64) - b.mean) / deviation


def sidak_limit(alpha: float, tests: int) -> float:
    """|z| that the largest of `tests` independent normal deviates passes with chance `alpha`."""
    each = -math.expm1(math.log1p(-alpha) / tests)
    return NormalDist().inv_cdf(1 - each / 2)


def student_limit(alpha: float, tests: int, runs: int) -> float:
    """sidak_limit() where the variance is that of `runs` runs: Student's t instead of the normal."""
    each = -math.expm1(math.log1p(-alpha) / tests)
    return float(scipy.stats.t.isf(each / 2, runs - 1))


@dataclass
class Comparison:
    """What compare() found; `failures` is empty if the images may have one expected value."""

    passing: float  # share of pixels, all of whose channels pass
    mean_ratio: np.ndarray  # by channel
    worst_block: float  # largest |z| of a block mean
    spread: float  # standard deviation of the pixels' z: 1 if both variances are right
    failures: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        ratios = " ".join(f"{100 * (ratio - 1):+.3f}%" for ratio in self.mean_ratio)
        return (
            f"{100 * self.passing:.3f} % of pixels pass, image mean {ratios}, "
            f"worst block |z| {self.worst_block:.2f}, spread of z {self.spread:.3f}"
        )


@dataclass(frozen=True)
class Limits:
    passing: float = 0.999  # least share of pixels
    mean: float = 0.002  # most relative difference of the image mean
    mean_z: float = 4.0  # and most |z| of it, which is the sharper one where noise is low
    block: float = 5.0  # most |z| of an 8x8 block
    block_size: int = 8
    spread: tuple[float, float] = (0.8, 1.25)  # of z over noisy pixels
    alpha: float = 0.01


def compare(test: Estimate, reference: Estimate, limits: Limits | None = None) -> Comparison:
    """Both estimates' variances count. Never raises on unequal images: see Comparison.failures."""
    limits = limits or Limits()
    if test.mean.shape != reference.mean.shape:
        raise ValueError(f"shapes differ: {test.mean.shape} and {reference.mean.shape}")
    if not (np.isfinite(test.mean).all() and np.isfinite(test.variance).all()):
        return Comparison(0, np.full(test.mean.shape[2], np.nan), np.inf, np.nan, ["not finite"])
    z = z_scores(test, reference)
    mean_z = float(np.abs(z_scores(test.whole(), reference.whole())).max())
    passes = (np.abs(z) <= sidak_limit(limits.alpha, z.size)).all(axis=2)
    test_mean = test.mean.mean(axis=(0, 1), dtype=np.float64)
    ratio = test_mean / reference.mean.mean(axis=(0, 1), dtype=np.float64)
    block_z = z_scores(test.blocks(limits.block_size), reference.blocks(limits.block_size))
    noisy = reference.variance > 0
    spread = float(z[noisy].std()) if noisy.any() else 1.0
    result = Comparison(float(passes.mean()), ratio, float(np.abs(block_z).max()), spread)
    if result.passing < limits.passing:
        y, x = np.argwhere(~passes)[0]
        result.failures.append(
            f"{(~passes).sum()} of {passes.size} pixels fail, the first at x {x}, y {y}: "
            f"{test.mean[y, x]} against {reference.mean[y, x]}, z {z[y, x]}"
        )
    if np.abs(ratio - 1).max() > limits.mean:
        result.failures.append(f"image mean is off by more than {limits.mean:.1%}: ratio {ratio}")
    if mean_z > limits.mean_z:
        result.failures.append(f"image mean is {mean_z:.1f} deviations off: ratio {ratio}")
    if result.worst_block > limits.block:
        row, column, plane = np.unravel_index(np.abs(block_z).argmax(), block_z.shape)
        result.failures.append(
            f"block {column}, {row} of {limits.block_size}x{limits.block_size} pixels, channel "
            f"{plane}: z {block_z[row, column, plane]:.2f}"
        )
    if not limits.spread[0] <= spread <= limits.spread[1]:
        result.failures.append(f"z spreads by {spread:.3f}: a variance is wrong")
    return result
