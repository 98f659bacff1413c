"""The image tests themselves: equal images pass, small faults do not. What compares PAVE must be able to fail.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import mitsuba_reference
import numpy as np
import pytest
from image_statistics import Estimate, compare, sidak_limit, z_scores
from mitsuba_reference import RECIPES, Reference

SPP = 2048


@pytest.fixture(scope="module")
def reference() -> Estimate:
    return Reference("cornell").estimate()


@pytest.fixture(scope="module")
def sample_variance(reference) -> np.ndarray:
    recipe = RECIPES["cornell"]
    return reference.variance.astype(np.float64) * recipe.runs * recipe.spp


def draw(reference: Estimate, sample_variance: np.ndarray, seed: int, mean=None) -> Estimate:
    """An image of SPP samples a pixel with the reference's (or another) expected value."""
    noise = np.random.default_rng(seed).standard_normal(reference.mean.shape)
    variance = sample_variance / SPP
    mean = reference.mean if mean is None else mean
    return Estimate(mean + noise * np.sqrt(variance), variance)


@pytest.mark.parametrize("seed", range(5))
def test_equal_images_pass(reference, sample_variance, seed):
    result = compare(draw(reference, sample_variance, seed), reference)
    assert not result.failures, f"seed {seed}: {result}"


def test_dim_light_fails(reference, sample_variance):
    image = draw(reference, sample_variance, 1, mean=0.995 * reference.mean)
    assert any("image mean" in failure for failure in compare(image, reference).failures)


def test_shifted_image_fails(reference, sample_variance):
    """A quarter of a pixel to the side."""
    shifted = 0.75 * reference.mean + 0.25 * np.roll(reference.mean, 1, axis=1)
    result = compare(draw(reference, sample_variance, 1, mean=shifted), reference)
    assert any("pixels fail" in failure for failure in result.failures)


def test_a_dark_corner_fails(reference, sample_variance):
    """Two percent less in one block of 8x8 pixels, which no single pixel shows."""
    mean = reference.mean.copy()
    mean[24:32, 8:16] *= 0.98
    result = compare(draw(reference, sample_variance, 1, mean=mean), reference)
    assert result.passing >= 0.999
    assert any("block" in failure for failure in result.failures)


@pytest.mark.parametrize("factor", [0.4, 2.5])
def test_a_wrong_variance_fails(reference, sample_variance, factor):
    image = draw(reference, sample_variance, 1)
    result = compare(Estimate(image.mean, image.variance * factor), reference)
    assert any("variance" in failure for failure in result.failures)


def test_swapped_channels_fail(reference, sample_variance):
    image = draw(reference, sample_variance, 1, mean=reference.mean[..., ::-1])
    assert len(compare(image, reference).failures) >= 3


def test_one_pixel_that_is_not_finite_fails(reference, sample_variance):
    image = draw(reference, sample_variance, 1)
    image.mean[3, 4, 1] = np.nan
    assert compare(image, reference).failures == ["not finite"]


def test_sidak_limit_holds_the_family_wise_rate():
    """Of 2000 families of 500 normal deviates about 1 % pass the limit in some member."""
    limit = sidak_limit(0.01, 500)
    worst = np.abs(np.random.default_rng(7).standard_normal((2000, 500))).max(axis=1)
    assert 0.005 < (worst > limit).mean() < 0.016  # 20 expected, deviation 4.4


def test_estimate_of_runs_is_the_mean_and_its_variance():
    runs = [np.full((2, 2, 1), value, np.float32) for value in (1.0, 2.0, 6.0)]
    estimate = Estimate.of_runs(runs)
    assert estimate.mean[0, 0, 0] == 3.0
    assert estimate.variance[0, 0, 0] == pytest.approx(7.0 / 3.0)
    assert np.allclose(Estimate.of_runs(runs).blocks(2).variance, 7.0 / 3.0 / 4.0)


def test_z_of_exact_images_is_small():
    exact = Estimate(np.full((4, 4, 3), 18.0), np.zeros((4, 4, 3)))
    rounded = Estimate(exact.mean * (1 + 1e-6), exact.variance)
    assert np.abs(z_scores(exact, rounded)).max() < 1
    assert np.abs(z_scores(exact, Estimate(exact.mean * 1.001, exact.variance))).min() > 5


def mitsuba_image(recipe, path=None, first_seed=1000) -> Estimate:
    scene = mitsuba_reference.load(recipe, path)
    return Estimate.of_runs(mitsuba_reference.render_runs(scene, 16, 64, first_seed))


@pytest.mark.slow
def test_mitsuba_with_other_seeds_passes(reference):
    """The stored reference made live: the scene, Mitsuba and the statistics still agree."""
    result = compare(mitsuba_image(RECIPES["cornell"]), reference, mitsuba_reference.FEW_RUNS)
    assert not result.failures, result


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('value="0.73, 0.73, 0.73"', 'value="0.74, 0.74, 0.74"'),
        ('<integer name="max_depth" value="50"/>', '<integer name="max_depth" value="5"/>'),
        ('<translate y="0.995"/>', '<translate y="0.995" x="0.02"/>'),
        ('<float name="fov" value="39.3"/>', '<float name="fov" value="39.5"/>'),
        ('angle="18"', 'angle="19"'),
    ],
    ids=["albedo", "depth", "light", "fov", "cuboid"],
)
def test_mitsuba_with_a_fault_fails(reference, tmp_path, old, new):
    recipe = RECIPES["cornell"]
    text = recipe.scene_path.read_text()
    assert old in text
    path = tmp_path / "fault.xml"
    path.write_text(text.replace(old, new))
    result = compare(mitsuba_image(recipe, path), reference, mitsuba_reference.FEW_RUNS)
    assert result.failures, f"{old} -> {new}: {result}"
