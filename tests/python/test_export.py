"""The exported graph computes what the torch module computes, layer by layer, and damage is found.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from torch import nn
from training_data import make_sample, make_samples, one_thread  # noqa: F401

from pave.errors import InputError, UsageError
from pave.export import (
    GRAPH_FILE,
    INPUT,
    OPS,
    WEIGHTS_FILE,
    export_generator,
    load_generator,
    pad_to_multiple,
    run_graph,
    trace_graph,
)
from pave.files import MANIFEST
from pave.models import Generator, GeneratorOptions
from pave.schema import Schema, fit_schema

CHANNELS = ["albedo", "direct", "normal", "depth"]


def schema() -> Schema:
    return fit_schema(make_samples(2), CHANNELS)


def trained_generator(**options: object) -> Generator:
    """A generator whose norms have statistics and scales that differ from the identity."""
    torch.manual_seed(3)
    network = Generator(10, GeneratorOptions(filters=4, **options), direct_first=3)  # type: ignore[arg-type]
    with torch.no_grad():
        for module in network.modules():
            if isinstance(module, (nn.BatchNorm2d, nn.InstanceNorm2d)):
                module.weight.uniform_(0.5, 1.5)
                module.bias.uniform_(-0.5, 0.5)
        network.train()
        for _ in range(3):
            network(torch.rand(4, 10, 64, 64))
    return network.eval()


def check_layers(network: nn.Module, buffers: torch.Tensor) -> None:
    """Compares every node that is a module with what the module put out, and the result."""
    seen: dict[str, torch.Tensor] = {}
    hooks = [
        module.register_forward_hook(lambda _m, _i, out, name=name: seen.__setitem__(name, out))
        for name, module in network.named_modules()
        if not list(module.children())
    ]
    with torch.no_grad():
        expected = network(buffers)
    for hook in hooks:
        hook.remove()
    nodes, result, weights = trace_graph(network)
    assert {node["op"] for node in nodes} <= set(OPS)
    with torch.no_grad():
        outputs = run_graph(nodes, result, weights, buffers)
    compared = 0
    for name, tensor in seen.items():
        error = float((outputs[name] - tensor).abs().max())
        assert error < 1e-5, f"layer {name}: {error:.2e}"
        compared += 1
    assert compared == len(seen) > 0
    assert float((outputs[result] - expected).abs().max()) < 1e-5


@pytest.mark.parametrize("head", ["sigmoid", "residual"])
@pytest.mark.parametrize("norm", ["batch", "instance", "none"])
def test_graph_equals_module_layer_by_layer(head: str, norm: str) -> None:
    network = trained_generator(unet_depth=4, head=head, norm=norm)
    generator = torch.Generator().manual_seed(1)
    for _ in range(5):
        check_layers(network, torch.rand(1, 10, 64, 64, generator=generator) * 2 - 0.5)


class EveryOperation(nn.Module):
    """Uses each operation of the format at least once."""

    def __init__(self) -> None:
        super().__init__()
        self.down = nn.Conv2d(5, 6, (3, 3), stride=2, padding=1)
        self.batch = nn.BatchNorm2d(6)
        self.leak = nn.LeakyReLU(0.3)
        self.instance = nn.InstanceNorm2d(6, affine=True)
        self.up = nn.ConvTranspose2d(6, 3, 4, stride=2, padding=1, bias=False)
        self.nearest = nn.Upsample(scale_factor=2, mode="nearest")
        self.relu = nn.ReLU()
        self.tanh = nn.Tanh()
        self.sigmoid = nn.Sigmoid()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = self.instance(self.leak(self.batch(self.down(x))))
        a, b = self.tanh(self.up(y)), self.relu(self.nearest(y))
        c = torch.cat([a, b], 1)[:, 1:4] * x[:, :3] + a
        return self.sigmoid(c)


def test_every_operation_of_the_format() -> None:
    torch.manual_seed(0)
    network = EveryOperation().eval()
    nodes, _, _ = trace_graph(network)
    assert {node["op"] for node in nodes} == set(OPS)
    check_layers(network, torch.randn(2, 5, 8, 12))


class Unsupported(nn.Module):
    def __init__(self, kind: str) -> None:
        super().__init__()
        self.kind = kind
        self.pool = nn.MaxPool2d(2)
        self.dilated = nn.Conv2d(3, 3, 3, dilation=2)
        self.bare = nn.InstanceNorm2d(3)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        if self.kind == "exp":
            return torch.exp(x)
        if self.kind == "rows":
            return torch.cat([x, x], 2)
        if self.kind == "scalar":
            return x * 2.0
        return getattr(self, self.kind)(x)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("pool", r"layer 'pool' \(MaxPool2d\)"),
        ("dilated", "layer 'dilated'"),
        ("bare", "layer 'bare'"),
        ("exp", r"\(exp\)"),
        ("rows", "axis 2"),
        ("scalar", r"\(mul\)"),
    ],
)
def test_what_cannot_be_exported_is_named(kind: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        trace_graph(Unsupported(kind))


def test_file_format(tmp_path: Path) -> None:
    """The keys that host/nn reads, and the checksum in the graph is that of the weights."""
    import pave

    version = export_generator(tmp_path, trained_generator(unet_depth=2), schema(), {"epochs": 3})
    record = json.loads((tmp_path / GRAPH_FILE).read_text())
    assert (record["format"], record["version"], record["multiple"]) == ("pave-generator", 1, 4)
    blob = (tmp_path / WEIGHTS_FILE).read_bytes()
    assert record["weights"] == {"file": WEIGHTS_FILE, "xxh3_128": pave.hash_bytes(blob)}
    assert record["weights"]["xxh3_128"] == version
    assert [item["channel"] for item in record["inputs"]] == CHANNELS
    assert record["transfer"]["name"] == "srgb_log"
    assert record["output"] == {"channel": "color", "planes": 3, "decode": "radiance"}
    assert record["training"] == {"epochs": 3}
    names = {INPUT}
    for node in record["nodes"]:
        assert set(node["inputs"]) <= names, "a node comes before its inputs"
        assert node["name"] not in names
        names.add(node["name"])
    assert record["result"] in names
    convolution = record["nodes"][0]
    assert convolution == {
        "name": "encode.0.conv",
        "op": "conv2d",
        "inputs": ["input"],
        "weight": "encode.0.conv.weight",
        "bias": "encode.0.conv.bias",
        "stride": 2,
        "padding": 1,
    }
    manifest = json.loads((tmp_path / MANIFEST).read_text())
    assert set(manifest["xxh3_128"]) == {GRAPH_FILE, WEIGHTS_FILE}
    assert not list(tmp_path.glob(".*")), "a temporary file was left behind"


@pytest.mark.parametrize("size", [(32, 32), (33, 21), (5, 3), (1, 1)])
def test_any_size_is_drawn(tmp_path: Path, size: tuple[int, int]) -> None:
    network = trained_generator(unet_depth=3)
    export_generator(tmp_path, network, schema(), {})
    loaded = load_generator(tmp_path)
    sample = make_sample(7, size=size[1], height=size[0])
    image = loaded.draw(sample)
    assert image.shape == (3, *size)
    assert bool(torch.isfinite(image).all())
    assert float(image.min()) >= 0
    buffers = pad_to_multiple(loaded.schema.encode_inputs(sample)[None], network.multiple)
    with torch.no_grad():
        expected = loaded.schema.decode_output(network(buffers)[0, :, : size[0], : size[1]])
    torch.testing.assert_close(image, expected, rtol=1e-4, atol=1e-5)
    batch = {name: torch.stack([value, value]) for name, value in sample.items()}
    torch.testing.assert_close(loaded.draw(batch)[1], image, rtol=1e-4, atol=1e-5)


def test_every_flipped_byte_is_found(tmp_path: Path) -> None:
    export_generator(tmp_path, trained_generator(unet_depth=2), schema(), {})
    for name in (GRAPH_FILE, WEIGHTS_FILE, MANIFEST):
        path = tmp_path / name
        data = path.read_bytes()
        for position in range(0, len(data), max(1, len(data) // 40)):
            damaged = bytearray(data)
            damaged[position] ^= 0x10
            path.write_bytes(damaged)
            if name == MANIFEST and json_equal(data, damaged):
                continue
            with pytest.raises(InputError, match=str(tmp_path)):
                load_generator(tmp_path)
        for length in (0, 1, len(data) // 2, len(data) - 2):
            path.write_bytes(data[:length])
            with pytest.raises(InputError):
                load_generator(tmp_path)
        path.write_bytes(data)
    load_generator(tmp_path)


def json_equal(one: bytes, other: bytes) -> bool:
    """Whether the flip only touched white space or a key that nobody reads."""
    try:
        keys = ("format", "xxh3_128")
        a, b = json.loads(one), json.loads(other)
        return all(a.get(key) == b.get(key) for key in keys)
    except (ValueError, AttributeError):
        return False


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=MANIFEST):
        load_generator(tmp_path)
    export_generator(tmp_path, trained_generator(unet_depth=2), schema(), {})
    (tmp_path / WEIGHTS_FILE).unlink()
    with pytest.raises(InputError, match=WEIGHTS_FILE):
        load_generator(tmp_path)


def test_weights_of_another_schema_are_refused(tmp_path: Path) -> None:
    export_generator(tmp_path, trained_generator(unet_depth=2), schema(), {})
    sample = make_sample(0)
    del sample["depth"]
    with pytest.raises(UsageError, match="missing input: depth"):
        load_generator(tmp_path).draw(sample)
