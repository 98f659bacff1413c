"""PAVE against an independent renderer: Mitsuba 3.9.1 reading the same scene files.

The references (mean and variance by pixel) are stored; make_references.py makes them.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import os

import mitsuba_reference
import numpy as np
import pytest
from image_statistics import Estimate, Limits, compare, student_limit
from mitsuba_reference import RECIPES, Recipe, Reference

import pave

DEVICE = os.environ.get("PAVE_DEVICE", "cpu")
CHANNELS = ("color", "variance", "direct", "albedo", "normal", "depth", "distance", "position")
SEED = 11

# Samples a pixel, and what must hold. The first line is the contract; the others are coarser: their
# materials have heavier tails, for which a normal distribution of the mean is an approximation.
CASES = {
    "cornell": (4096, Limits()),
    "novel": (2048, Limits(passing=0.998, mean=0.004)),
    "materials": (4096, Limits(passing=0.99, mean=0.006, block=6.0)),
    # The noise of both sides is half a percent of the red mean: small bright lights, rarely met.
    "textures": (4096, Limits(mean=0.005)),
    "envmap": (4096, Limits(mean=0.005)),
    "instances": (4096, Limits(passing=0.998, mean=0.004)),
    "many-lights": (16384, Limits(passing=0.99, mean=0.015, block=6.0)),
}


@pytest.fixture(scope="module")
def images():
    """Renders each scene once: {channel: (H, W, C)}."""
    device = pave.Device(DEVICE)
    done: dict[str, dict[str, np.ndarray]] = {}

    def get(name: str) -> dict[str, np.ndarray]:
        if name not in done:
            done[name] = render(device, RECIPES[name], CASES[name][0], SEED)
        return done[name]

    return get


def render(
    device: pave.Device,
    recipe: Recipe,
    spp: int,
    seed: int,
    max_depth: int | None = None,
    sampler: str = "independent",
) -> dict[str, np.ndarray]:
    """Channels as (H, W, C). Of independent samples, the variance is exactly the error's."""
    scene = pave.load_scene(recipe.scene_path, defines=recipe.defines)
    assert (scene.width, scene.height) == (recipe.width, recipe.height)
    # Where there are instances, their own way through the kernels is the one to be judged.
    renderer = pave.Renderer(device, scene, copied_triangles=-1)
    size = {"width": scene.width, "height": scene.height}
    with pave.Stage(device, "mem:", channels=CHANNELS, slots=1, **size) as stage:
        frame = stage.acquire()
        renderer.render(None, frame, spp=spp, seed=seed, max_depth=max_depth, sampler=sampler)
        assert renderer.dropped_samples == 0
        return {name: np.moveaxis(frame[name].numpy(copy=True), 0, 2) for name in CHANNELS}


def rerun(name: str) -> str:
    return f"rerun: pytest {__file__} -k {name}; PAVE_DEVICE={DEVICE}, seed {SEED}"


@pytest.mark.parametrize("name", CASES)
def test_image_is_mitsubas(images, name):
    image = images(name)
    result = compare(
        Estimate(image["color"], image["variance"]), Reference(name).estimate(), CASES[name][1]
    )
    print(f"{name}: {result}")
    assert not result.failures, f"{result}\n" + "\n".join([*result.failures, rerun(name)])


@pytest.mark.parametrize("name", CASES)
def test_stratified_image_is_mitsubas(name):
    """The default sampler has less noise than its variance says, and no other mean."""
    spp, limits = CASES[name]
    image = render(pave.Device(DEVICE), RECIPES[name], spp, SEED, sampler="sobol")
    result = compare(
        Estimate(image["color"], image["variance"]), Reference(name).estimate(), limits
    )
    print(f"{name}: {result}")
    failures = [line for line in result.failures if not line.startswith("z spreads")]
    assert not failures, f"{result}\n" + "\n".join([*failures, rerun(name)])
    assert result.spread < 1.03


@pytest.mark.parametrize("name", CASES)
def test_direct_is_a_path_of_two_edges(images, name):
    """Of the same seed it is the colour of a render of depth 2, whose variance PAVE keeps."""
    spp, limits = CASES[name]
    short = render(pave.Device(DEVICE), RECIPES[name], spp, SEED, max_depth=2)
    assert np.abs(images(name)["direct"] - short["color"]).max() <= 1e-5 * short["color"].max()
    test = Estimate(short["color"], short["variance"])
    result = compare(test, Reference(name).estimate("direct"), limits)
    print(f"{name}: {result}")
    assert not result.failures, f"{result}\n" + "\n".join([*result.failures, rerun(name)])


def near_plane_distance(name: str) -> np.ndarray:
    """(H, W, 1) from the pinhole to Mitsuba's near plane, where its ray lengths begin."""
    recipe = RECIPES[name]
    view = pave.load_scene(recipe.scene_path, defines=recipe.defines).view
    half = np.tan(np.radians(view.fov) / 2)
    x = half * ((np.arange(recipe.width) + 0.5) * 2 / recipe.width - 1)
    y = half * ((np.arange(recipe.height) + 0.5) * 2 - recipe.height) / recipe.width
    near_clip = 0.01  # Mitsuba's default
    return (near_clip * np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2))[..., None]


def aov_estimates(images, name: str, channel: str) -> tuple[Estimate, Estimate]:
    """PAVE's with the variance that its sample count gives by Mitsuba's sample variance, and Mitsuba's."""
    reference = Reference(name)
    variance = reference.sample_variance(channel) / CASES[name][0]
    expected = reference.estimate(channel)
    if channel == "distance":
        expected = Estimate(expected.mean + near_plane_distance(name), expected.variance)
    return Estimate(images(name)[channel], variance), expected


def worst_deviation(test: Estimate, reference: Estimate, tolerance: float) -> np.ndarray:
    """|difference| beyond `tolerance`, in standard deviations, largest of the planes of a pixel."""
    difference = np.abs(test.mean.astype(np.float64) - reference.mean) - tolerance
    deviation = np.sqrt(test.variance + reference.variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(difference <= 0, 0.0, difference / deviation)
    return z.max(axis=2)


def one_plane(name: str) -> np.ndarray:
    """Pixels that show a single flat surface and nothing else."""
    normal = Reference(name).estimate("normal").mean
    return np.linalg.norm(normal, axis=2) > 1 - 1e-5


@pytest.mark.parametrize("name", CASES)
def test_distance_and_position_on_planes(images, name):
    planes = one_plane(name)
    assert planes.mean() > 0.5, "the scene has too few pixels that show one plane"
    for channel in ("distance", "position"):
        z = worst_deviation(*aov_estimates(images, name, channel), tolerance=2e-4)
        limit = student_limit(0.01, 4 * int(planes.sum()), RECIPES[name].runs)
        # Light and ceiling are parallel: where a pixel sees a sliver of the other one, a few samples
        # decide, which is no normal distribution.
        passing = (z[planes] <= limit).mean()
        assert passing >= 0.999, f"{channel}: z {z[planes].max():.1f}; {rerun(name)}"


@pytest.mark.parametrize("name", CASES)
def test_depth_is_the_positions_along_the_view_axis(images, name):
    """Mitsuba has no planar depth, but mean depth is the mean position's."""
    recipe, reference = RECIPES[name], Reference(name)
    matrix = pave.load_scene(recipe.scene_path, defines=recipe.defines).view.matrix.astype(float)
    eye, forward = matrix[:3, 3], matrix[:3, 2]
    position = reference.estimate("position")
    expected = Estimate(
        ((position.mean - eye) @ forward)[..., None], (position.variance @ forward**2)[..., None]
    )
    variance = reference.sample_variance("position") @ forward**2 / CASES[name][0]
    # Position's planes are correlated: the bound is the sum of deviations, not of variances.
    depth = Estimate(images(name)["depth"], 3 * variance[..., None])
    z = worst_deviation(depth, expected, tolerance=2e-4)
    planes = one_plane(name)
    assert z[planes].max() <= student_limit(0.01, int(planes.sum()), RECIPES[name].runs), rerun(
        name
    )


@pytest.mark.parametrize("name", CASES)
def test_normals_point_where_mitsubas_do(images, name):
    """Unit vectors along the mean of the shading normals; also over edges and round shapes."""
    test, reference = aov_estimates(images, name, "normal")
    length = np.linalg.norm(reference.mean, axis=2, keepdims=True)
    seen = length[..., 0] > 0.2
    length = np.maximum(length, 1e-9)
    unit = Estimate(reference.mean / length, reference.variance / length**2)
    z = worst_deviation(Estimate(test.mean, test.variance / length**2), unit, tolerance=1e-3)
    limit = student_limit(0.01, 3 * int(seen.sum()), RECIPES[name].runs)
    # At silhouettes a pixel's normals have two peaks, and the quotient's error is not normal.
    assert (z[seen] <= limit).mean() >= 0.995, f"{(z[seen] > limit).sum()} pixels; {rerun(name)}"
    assert z[one_plane(name)].max() <= limit, rerun(name)
    norms = np.linalg.norm(images(name)["normal"], axis=2)
    assert np.abs(norms[seen] - 1).max() < 1e-4


@pytest.mark.parametrize("name", ["cornell", "novel"])
def test_albedo_is_mitsubas(images, name):
    """Only where every material is diffuse: elsewhere PAVE goes on to the first that is not specular."""
    test, reference = aov_estimates(images, name, "albedo")
    z = worst_deviation(test, reference, tolerance=2e-4)
    limit = student_limit(0.01, 3 * z.size, RECIPES[name].runs)
    assert (z <= limit).mean() >= 0.998, f"{(z > limit).sum()} pixels; {rerun(name)}"
    planes = one_plane(name)
    difference = np.abs(test.mean - reference.mean)[planes & (reference.variance.max(axis=2) == 0)]
    # A sliver of the light that none of the reference's samples met may be met by one of these.
    assert (difference.max(axis=-1) < 1e-5).mean() >= 0.999
    assert difference.max() < 2 / CASES[name][0]


def test_misses_are_where_mitsuba_has_none(images):
    """Beside the box: no colour, no normal, infinite depth."""
    image, reference = images("cornell"), Reference("cornell")
    missed = (reference.estimate("distance").mean == 0)[..., 0]
    assert 0.01 < missed.mean() < 0.5
    assert np.isposinf(image["depth"][missed]).all()
    assert np.isposinf(image["distance"][missed]).all()
    for channel in ("color", "direct", "albedo", "normal", "position"):
        assert not image[channel][missed].any(), channel
    assert np.isfinite(image["depth"][~missed]).mean() > 0.999


@pytest.mark.parametrize("name", ["cornell"])
def test_variance_is_that_of_other_seeds(images, name):
    """z between two seeds has deviation 1 if the variance channel tells the truth."""
    spp = 256
    device = pave.Device(DEVICE)
    pair = [render(device, RECIPES[name], spp, seed) for seed in (101, 202)]
    first, second = (Estimate(image["color"], image["variance"]) for image in pair)
    result = compare(first, second, Limits(passing=0.99, mean=0.01, spread=(0.95, 1.05)))
    assert not result.failures, result


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cornell", "materials"])
def test_live_mitsuba_agrees(images, name):
    """Not against the stored file: Mitsuba renders now, from the very file that PAVE has read."""
    recipe = RECIPES[name]
    runs = mitsuba_reference.render_runs(mitsuba_reference.load(recipe), 16, 128, first_seed=5000)
    limits = CASES[name][1]
    limits = Limits(passing=limits.passing - 0.003, mean=2 * limits.mean, block=limits.block + 1)
    image = images(name)
    result = compare(Estimate(image["color"], image["variance"]), Estimate.of_runs(runs), limits)
    print(f"{name}: {result}")
    assert not result.failures, f"{result}\n" + "\n".join([*result.failures, rerun(name)])
