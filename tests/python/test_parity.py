"""The generator on the OpenCL device computes what torch computes: every layer, and whole frames.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn
from training_data import make_sample, make_samples, one_thread  # noqa: F401

import pave
from pave.export import INPUT, export_generator, load_generator, run_graph
from pave.models import Generator, GeneratorOptions
from pave.schema import fit_schema

CHANNELS = ["albedo", "direct", "normal", "depth", "position"]
SIZE = 32
IMAGES = 20
# What fp32 may lose over this depth when sums are taken in another order; values are of order 1.
TOLERANCE = 1e-4


def trained(options: GeneratorOptions) -> tuple[nn.Module, object]:
    """A generator after some steps of training on made-up frames, and its schema."""
    samples = make_samples(4, size=SIZE)
    schema = fit_schema(samples, CHANNELS)
    torch.manual_seed(11)
    network = Generator(
        schema.in_planes, options, direct_first=schema.first_plane("direct")
    ).train()
    optimizer = torch.optim.Adam(network.parameters(), lr=2e-3)
    inputs = torch.stack([schema.encode_inputs(sample) for sample in samples])
    target = torch.stack([schema.encode_target(sample) for sample in samples])
    for _ in range(10):
        optimizer.zero_grad()
        (network(inputs) - target).abs().mean().backward()
        optimizer.step()
    return network.eval(), schema


@pytest.fixture(scope="module")
def device() -> pave.Device:
    return pave.Device()


@pytest.mark.parametrize("head", ["residual", "sigmoid"])
@pytest.mark.parametrize("norm", ["batch", "instance", "none"])
def test_every_layer_equals_torch(
    tmp_path: Path, device: pave.Device, norm: str, head: str
) -> None:
    network, schema = trained(GeneratorOptions(filters=8, unet_depth=4, norm=norm, head=head))
    version = export_generator(tmp_path, network, schema, {})
    exported = load_generator(tmp_path)
    generator = pave.Generator(device, str(tmp_path))
    assert generator.weights_version == version
    assert list(generator.inputs) == CHANNELS
    folded = {
        node["inputs"][0] for node in exported.nodes if node["op"] == "batch_norm"
    }  # convolutions that the norm's node stands for
    for index in range(IMAGES):
        sample = make_sample(100 + index, SIZE)
        buffers = schema.encode_inputs(sample)
        with torch.no_grad():
            expected = run_graph(exported.nodes, exported.result, exported.weights, buffers[None])
        image, layers = generator.run(buffers.numpy(), layers=True)
        assert set(layers) == set(expected) - folded
        for name, values in layers.items():
            error = np.abs(np.ravel(values) - expected[name].numpy().ravel()).max()
            assert error <= TOLERANCE, f"image {index}, layer {name}: {error:.2e}"
        assert np.ravel(layers[INPUT]).shape == (buffers.numel(),)
        with torch.no_grad():
            error = np.abs(image - network(buffers[None])[0].numpy()).max()
        assert error <= TOLERANCE, f"image {index}: {error:.2e}"
        assert (generator.run(buffers.numpy()) == image).all()


@pytest.mark.parametrize("size", [(SIZE, SIZE), (37, 21)])
def test_frames_are_drawn_as_torch_draws_them(
    tmp_path: Path, device: pave.Device, size: tuple[int, int]
) -> None:
    network, schema = trained(GeneratorOptions(filters=8, unet_depth=3))
    export_generator(tmp_path, network, schema, {})
    exported = load_generator(tmp_path)
    generator = pave.Generator(device, str(tmp_path))
    width, height = size
    channels = [*CHANNELS, "drawn"]
    with pave.Stage(
        device, "mem:parity", width=width, height=height, channels=channels, slots=2
    ) as stage:
        for index in range(3):
            sample = make_sample(200 + index, width, height)
            frame = stage.acquire()
            for name in CHANNELS:
                frame[name].numpy()[:] = sample[name].numpy()
            generator.draw(frame)
            drawn, expected = frame["drawn"].numpy(), exported.draw(sample).numpy()
            # Radiance is the exponential of what the network puts out: errors are relative where it is bright.
            error = np.abs(drawn - expected) / (1 + expected)
            assert error.max() <= 5 * TOLERANCE, f"image {index}: {error.max():.2e}"
            assert frame.metadata["weights_version"] == generator.weights_version
            del frame


def test_memory_is_planned(tmp_path: Path, device: pave.Device) -> None:
    network, schema = trained(GeneratorOptions(filters=8, unet_depth=4))
    export_generator(tmp_path, network, schema, {})
    planned, unplanned = pave.Generator(device, str(tmp_path)).planned_byte_size(256, 256)
    assert 0 < planned < 0.7 * unplanned
