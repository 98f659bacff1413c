"""The Python sketch that the design promises, run as written there: renders, shares, stages, loads and draws.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import numpy as np
import pytest
import torch

import pave
from pave.data import Dataset
from pave.dataset import RenderSettings, render_dataset
from pave.export import export_generator, load_generator, pad_to_multiple, run_graph
from pave.models import Generator, GeneratorOptions
from pave.schema import fit_schema

SKETCH = """
import pave
device   = pave.Device("pocl")
renderer = pave.Renderer(device, pave.load_scene("cornell"))
stage    = pave.Stage(device, "mem:", width=256, height=256, channels=["color", "albedo", "direct", "normal", "depth"], slots=8)
frame    = stage.acquire()
renderer.render(pave.look_at(eye, target, fov=40), frame, spp=64, max_depth=50, seed=7)
frame["color"].torch()      # (3, H, W) float32, the slot's own memory; likewise .numpy() and .cl_buffer() (pyopencl.Buffer)
pave.copies()               # how often PAVE copied pixels between slot and Python so far
stage.publish(frame); stage.flush()

loader = pave.DataLoader("bp:cornell.bp")
loader.open(["albedo", "direct", "normal", "depth", "color"])
train, test, validation = loader.get_split()                 # torch datasets: dict of (C, H, W) tensors by channel
loader.close()
pave.Generator(device, "run/").draw(frame)
"""
INPUTS = ["albedo", "direct", "normal", "depth"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with cornell.bp, five small views, and run/, a small network with random weights."""
    folder = tmp_path_factory.mktemp("sketch")
    scene = pave.load_scene("cornell")
    uri = f"bp:{folder}/cornell.bp"
    views = pave.hemisphere_views(scene, 5, seed=1)
    settings = RenderSettings(32, 32, 4, 6, channels=["color", *INPUTS])
    render_dataset(pave.Device("pocl"), scene, uri, views, settings)
    torch.manual_seed(5)
    schema = fit_schema(pave.Dataset(uri), INPUTS)
    options = GeneratorOptions(filters=4, unet_depth=2)
    network = Generator(schema.in_planes, options, direct_first=schema.first_plane("direct"))
    (folder / "run").mkdir()
    export_generator(folder / "run", network, schema, {"test": True})
    return folder


def test_the_sketch_runs_as_written(folder, monkeypatch):
    monkeypatch.chdir(folder)
    before = pave.copies()
    names = {"eye": (0.0, 0.0, -3.9), "target": (0.0, 0.0, 0.0)}
    scene = pave.load_scene("cornell")
    names["eye"] = tuple(float(x) for x in scene.view.matrix[:3, 3])
    names["target"] = tuple(float(x) for x in (scene.view.matrix @ [0, 0, 1, 1])[:3])
    exec(compile(SKETCH, "sketch", "exec"), names)
    frame = names["frame"]
    assert pave.copies() == before
    assert frame["color"].torch().shape == (3, 256, 256)
    assert float(frame["albedo"].torch().mean()) > 0.05
    parts = [names[part] for part in ("train", "test", "validation")]
    assert [len(part) for part in parts] == [3, 1, 1]
    assert all(isinstance(part, Dataset) for part in parts)
    sample = parts[0][0]
    assert list(sample) == [*INPUTS, "color"]
    assert sample["depth"].shape == (1, 32, 32)
    # The last line drew over "color": the same picture as torch makes of the same buffers.
    exported = load_generator("run")
    expected = exported.draw({name: frame[name].torch() for name in INPUTS})
    encode = exported.schema.encode_target
    error = (encode({"color": frame["color"].torch()}) - encode({"color": expected})).abs().max()
    assert float(error) < 1e-3
    assert frame.metadata["weights_version"] == exported.weights_version


def test_generator_agrees_with_torch_layer_by_layer(folder):
    """The bound of the export's contract: 1e-4 on every node's output."""
    exported = load_generator(folder / "run")
    generator = pave.Generator(pave.Device("pocl"), folder / "run")
    assert generator.inputs == INPUTS
    assert generator.weights_version == exported.weights_version
    sample = pave.Dataset(f"bp:{folder}/cornell.bp")[2]
    planes = pad_to_multiple(exported.schema.encode_inputs(sample)[None], exported.multiple)
    wanted = run_graph(exported.nodes, exported.result, exported.weights, planes)
    image, layers = generator.run(planes[0].numpy(), layers=True)
    np.testing.assert_allclose(image, wanted[exported.result][0].numpy(), atol=1e-4)
    assert layers
    for name, values in layers.items():
        np.testing.assert_allclose(values, wanted[name].numpy().ravel(), atol=1e-4, err_msg=name)
    np.testing.assert_array_equal(generator.run(planes[0]), image)
    planned, unplanned = generator.planned_byte_size(32, 32)
    assert 0 < planned < unplanned


def test_generator_names_what_is_missing(folder, tmp_path):
    device = pave.Device("pocl")
    generator = pave.Generator(device, folder / "run")
    frame = pave.make_frame(device, 32, 32, ["color", "albedo", "direct", "normal"])
    with pytest.raises(pave.UsageError, match="missing input: depth"):
        generator.draw(frame)
    with pytest.raises(pave.InputError):
        pave.Generator(device, tmp_path)
    with pytest.raises(pave.UsageError, match=r"\(C, H, W\)"):
        generator.run(np.zeros((3, 3)))


def test_drawn_has_a_channel_of_its_own(folder):
    device = pave.Device("pocl")
    generator = pave.Generator(device, folder / "run")
    before = pave.copies()
    frame = pave.make_frame(device, 32, 32, ["color", *INPUTS, "drawn"])
    sample = pave.Dataset(f"bp:{folder}/cornell.bp")[1]
    for name, tensor in sample.items():
        frame[name].torch().copy_(tensor)
    generator.draw(frame)
    assert torch.equal(frame["color"].torch(), sample["color"])
    assert float(frame["drawn"].torch().abs().sum()) > 0
    assert pave.copies() == before
