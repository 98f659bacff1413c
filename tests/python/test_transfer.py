"""Transfer function, encodings and the schema that carries their scales.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import json
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.color.colorconv import xyz2rgb, xyz_from_rgb
from training_data import make_sample, make_samples

from pave import transfer
from pave.errors import InputError, UsageError
from pave.schema import InputSpec, Schema, fit_schema

HALF_FLOAT_MAX = 65504.0


@settings(derandomize=True, deadline=None, max_examples=300)
@given(
    st.floats(0.0, HALF_FLOAT_MAX, width=32, allow_subnormal=False),
    st.floats(1.0, 1e4, width=32),
)
def test_radiance_comes_back(value: float, peak: float) -> None:
    x = torch.tensor(value, dtype=torch.float32)
    y = transfer.decode_radiance(transfer.encode_radiance(x, peak), peak)
    # 1e-3 relative is the promise; near 0 the spacing of encoded floats decides, 1e-7 is far below one step of 8 bits.
    assert float(y) == pytest.approx(float(x), rel=1e-3, abs=1e-7)


def test_round_trip_over_the_whole_range() -> None:
    x = torch.cat([torch.zeros(1), torch.logspace(-6, math.log10(HALF_FLOAT_MAX), 200_000)])
    for peak in (1.0, 17.0, 5000.0):
        y = transfer.decode_radiance(transfer.encode_radiance(x, peak), peak)
        error = ((y - x).abs() / x.clamp_min(1e-6)).max()
        assert float(error) < 1e-3, f"peak {peak}: relative error {float(error):.2e}"


def test_is_srgb_up_to_one() -> None:
    x = torch.linspace(0, 1, 4097, dtype=torch.float64)
    # Gray in CIE XYZ with D65 white: scikit-image's own sRGB curve.
    linear = x.numpy()[:, None, None].repeat(3, 2)
    xyz = linear @ xyz_from_rgb.T
    theirs = torch.from_numpy(xyz2rgb(xyz)[:, 0, 0].copy())
    assert float((transfer.compress(x) - theirs).abs().max()) < 1e-9


def test_is_smooth_and_rising_through_one() -> None:
    x = torch.linspace(0, 20, 400_001, dtype=torch.float64)
    y = transfer.compress(x)
    assert bool((y[1:] > y[:-1]).all())
    step = 1e-6
    below = (
        transfer.compress(torch.tensor(1.0 - 0.0, dtype=torch.float64))
        - transfer.compress(torch.tensor(1.0 - step, dtype=torch.float64))
    ) / step
    above = (
        transfer.compress(torch.tensor(1.0 + step, dtype=torch.float64))
        - transfer.compress(torch.tensor(1.0, dtype=torch.float64))
    ) / step
    assert float(below) == pytest.approx(1.055 / 2.4, abs=1e-5)
    assert float(above) == pytest.approx(1.055 / 2.4, abs=1e-5)


def test_known_values() -> None:
    """The numbers that host/nn is held to as well."""
    x = torch.tensor([-3.0, 0.0, 0.001, 0.0031308, 0.18, 1.0, math.e, 17.0])
    expected = [0.0, 0.0, 0.01292, 0.040449936, 0.46135613, 1.0, 1.4395833, 2.2454334]
    assert transfer.compress(x).tolist() == pytest.approx(expected, abs=2e-7)
    assert transfer.compressed_peak(17.0) == pytest.approx(2.2454334, abs=1e-6)
    assert float(transfer.encode_radiance(torch.tensor(17.0), 17.0)) == pytest.approx(1.0, abs=1e-6)


def test_depth_and_position_come_back() -> None:
    sample = make_sample(3)
    depth = sample["depth"]
    encoded = transfer.encode_depth(depth, 4.0)
    assert bool((encoded[torch.isinf(depth)] == 0).all())
    assert bool(((encoded >= 0) & (encoded <= 1)).all())
    torch.testing.assert_close(transfer.decode_depth(encoded, 4.0), depth, rtol=1e-4, atol=1e-5)
    center, radius = [0.5, -1.0, 2.0], 3.0
    position = sample["position"]
    encoded = transfer.encode_position(position, center, radius)
    decoded = transfer.decode_position(encoded, center, radius)
    torch.testing.assert_close(decoded, position, rtol=1e-5, atol=1e-6)


def test_same_pixel_same_number_whatever_the_image() -> None:
    """No scale comes from one image: a pixel's number does not change with its neighbours'."""
    schema = fit_schema(make_samples(3), ["albedo", "direct", "normal", "depth"])
    sample = make_sample(0)
    changed = {name: value.clone() for name, value in sample.items()}
    changed["depth"][0, -1, -1] = 1e6
    changed["direct"][:, -1, -1] = 900.0
    here, there = schema.encode_inputs(sample), schema.encode_inputs(changed)
    assert torch.equal(here[:, :-1, :-1], there[:, :-1, :-1])
    assert float(here[6:9].min()) < -0.5, "the sign of normals is lost"


def test_fitted_schema_and_its_json() -> None:
    samples = make_samples(4)
    channels = ["normal", "depth", "position", "albedo", "direct"]
    schema = fit_schema(samples, channels, repeat_depth=3)
    assert schema.in_planes == 3 + 3 + 3 + 3 + 3
    assert schema.first_plane("direct") == 12
    assert schema.first_plane("color") is None
    assert schema.peak == pytest.approx(max(float(s["color"].max()) for s in samples))
    finite = torch.stack([s["depth"][torch.isfinite(s["depth"])].median() for s in samples])
    assert schema.inputs[1].scale == pytest.approx(float(finite.median()))
    for sample in samples:
        inside = schema.encode_inputs(sample)[6:9].norm(dim=0)
        assert float(inside.max()) <= 1 + 1e-5, "a position is outside the unit sphere"
    assert schema.encode_inputs(samples[0]).shape == (15, 32, 32)
    batch = {name: torch.stack([s[name] for s in samples]) for name in samples[0]}
    assert torch.equal(schema.encode_inputs(batch)[2], schema.encode_inputs(samples[2]))
    text = json.dumps(schema.to_json())
    assert Schema.from_json(json.loads(text), "test") == schema


def test_dark_scene_has_peak_one() -> None:
    sample = {name: value * 0.01 for name, value in make_sample(0).items()}
    assert fit_schema([sample], ["direct"]).peak == 1.0


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ([], "at least one"),
        (["color"], "cannot be an input"),
        (["object"], "cannot be an input"),
        (["albdeo"], "'albdeo'"),
        (["albedo", "albedo"], "twice"),
        (["distance"], "missing channel: distance"),
    ],
)
def test_bad_channels_are_named(channels: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        fit_schema(make_samples(1), channels)


def test_missing_and_misshapen_inputs_are_named() -> None:
    schema = fit_schema(make_samples(1), ["albedo", "depth"])
    sample = make_sample(0)
    with pytest.raises(UsageError, match="missing input: depth"):
        schema.encode_inputs({"albedo": sample["albedo"]})
    with pytest.raises(InputError, match="channel 'depth' has 3 planes"):
        schema.encode_inputs({**sample, "depth": sample["albedo"]})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transfer": {"name": "pq", "peak": 1}}, "unknown transfer 'pq'"),
        ({"inputs": [{"channel": "x", "planes": 3, "encode": "magic"}]}, "unknown encoding"),
        ({"inputs": [{"channel": "x", "planes": 3, "encode": "unit", "odd": 1}]}, "odd"),
        ({"output": {}}, "missing key 'planes'"),
    ],
)
def test_bad_schema_files_are_named(change: dict, message: str) -> None:
    record = Schema((InputSpec("albedo", 3, "unit"),)).to_json()
    with pytest.raises(InputError, match=message):
        Schema.from_json({**record, **change}, "generator.json")
