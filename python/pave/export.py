"""The generator as data: a graph traced from the torch module, its weights, and an interpreter that checks both.

SPDX-License-Identifier: BSD-3-Clause

    generator.safetensors   weights by name
    generator.json          inputs and encodings, transfer, nodes in order, provenance; the weights' checksum
    run-manifest.json       checksums of these files, verified before either is parsed

host/nn reads the first two. Nothing is pickled.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import fx, nn
from torch.nn import functional

from pave.errors import InputError, UsageError
from pave.files import hash_bytes, read_bytes, verify_manifest, write_atomic, write_manifest
from pave.schema import Schema

FORMAT, VERSION = "pave-generator", 1
GRAPH_FILE, WEIGHTS_FILE = "generator.json", "generator.safetensors"
INPUT = "input"  # name of the node that nobody computes: the encoded buffers

OPS = (
    "conv2d",
    "conv_transpose2d",
    "batch_norm",
    "instance_norm",
    "leaky_relu",
    "relu",
    "sigmoid",
    "tanh",
    "concat",
    "add",
    "mul",
    "slice_channels",
    "upsample_nearest",
)

Node = dict[str, Any]
Weights = dict[str, torch.Tensor]


def trace_graph(module: nn.Module) -> tuple[list[Node], str, Weights]:
    """Nodes in order of execution, the result's name, and the weights, of a module with one input.

    Raises UsageError naming the first operation that is not one of OPS.
    """
    traced = fx.symbolic_trace(module)
    tracer = _GraphWriter(dict(traced.named_modules()))
    for node in traced.graph.nodes:
        tracer.add(node)
    return tracer.nodes, tracer.result, tracer.weights


class _GraphWriter:
    """Turns torch.fx nodes into nodes of generator.json."""

    def __init__(self, modules: dict[str, nn.Module]) -> None:
        self.modules = modules
        self.names: dict[fx.Node, str] = {}  # name of the output of each fx node
        self.nodes: list[Node] = []
        self.weights: Weights = {}
        self.result = INPUT

    def add(self, node: fx.Node) -> None:
        if node.op == "placeholder":
            if self.names:
                raise UsageError("a network that can be exported has one input")
            self.names[node] = INPUT
        elif node.op == "output":
            self.result = self.names[node.args[0]]
        elif node.op == "call_module":
            self._call_module(node)
        elif node.op in ("call_function", "call_method"):
            self._call_function(node)
        else:
            raise UsageError(f"'{node.name}' ({node.op}) cannot be exported")

    def _append(self, node: fx.Node, name: str, op: str, inputs: list[Any], **values: Any) -> None:
        self.names[node] = name
        self.nodes.append(
            {"name": name, "op": op, "inputs": [self.names[item] for item in inputs], **values}
        )

    def _keep(self, name: str, tensor: torch.Tensor | None) -> str | None:
        if tensor is None:
            return None
        self.weights[name] = tensor.detach().to("cpu", torch.float32).contiguous().clone()
        return name

    def _call_module(self, node: fx.Node) -> None:
        path, module = str(node.target), self.modules[str(node.target)]
        writer = _MODULES.get(type(module))
        if writer is None:
            raise UsageError(f"layer '{path}' ({type(module).__name__}) cannot be exported")
        op, values = writer(path, module)
        for key in ("weight", "bias", "running_mean", "running_var"):
            if key in values:
                values[key] = self._keep(f"{path}.{key}", getattr(module, key))
        self._append(node, path, op, [node.args[0]], **values)

    def _call_function(self, node: fx.Node) -> None:
        kind = node.target if isinstance(node.target, str) else node.target.__name__
        if kind in ("cat", "concat"):
            axis = node.args[1] if len(node.args) > 1 else node.kwargs.get("dim", 0)
            if axis not in (1, -3):
                raise UsageError(
                    f"'{node.name}' joins axis {axis}; only planes (1) can be exported"
                )
            self._append(node, node.name, "concat", list(node.args[0]))
        elif kind in ("add", "mul") and all(isinstance(item, fx.Node) for item in node.args):
            self._append(node, node.name, kind, list(node.args))
        elif kind == "getitem" and _is_plane_slice(node.args[1]):
            planes = node.args[1][1]
            first, last = planes.start or 0, planes.stop
            if last is None or first < 0 or last <= first or planes.step not in (None, 1):
                raise UsageError(f"'{node.name}': give both ends of the slice of planes")
            self._append(
                node, node.name, "slice_channels", [node.args[0]], first=first, count=last - first
            )
        else:
            raise UsageError(f"operation '{node.name}' ({kind}) cannot be exported")


def _is_plane_slice(index: Any) -> bool:
    return isinstance(index, tuple) and len(index) == 2 and index[0] == slice(None)


def _same(path: str, what: str, values: Any) -> int:
    """The one value of a pair such as stride (2, 2)."""
    pair = values if isinstance(values, tuple) else (values, values)
    if pair[0] != pair[1] or not isinstance(pair[0], int):
        raise UsageError(f"layer '{path}': {what} {values} cannot be exported")
    return pair[0]


def _convolution(path: str, module: Any) -> tuple[str, Node]:
    transposed = isinstance(module, nn.ConvTranspose2d)
    plain = module.groups == 1 and _same(path, "dilation", module.dilation) == 1
    if not plain or module.padding_mode != "zeros":
        raise UsageError(f"layer '{path}': groups, dilation and padding modes cannot be exported")
    if transposed and _same(path, "output padding", module.output_padding) != 0:
        raise UsageError(f"layer '{path}': output padding cannot be exported")
    return "conv_transpose2d" if transposed else "conv2d", {
        "weight": "",
        "bias": "",
        "stride": _same(path, "stride", module.stride),
        "padding": _same(path, "padding", module.padding),
    }


def _batch_norm(path: str, module: nn.BatchNorm2d) -> tuple[str, Node]:
    if module.running_mean is None or module.weight is None:
        raise UsageError(f"layer '{path}': a batch norm without statistics cannot be exported")
    return "batch_norm", {
        "weight": "",
        "bias": "",
        "running_mean": "",
        "running_var": "",
        "eps": module.eps,
    }


def _instance_norm(path: str, module: nn.InstanceNorm2d) -> tuple[str, Node]:
    if module.track_running_stats or module.weight is None:
        raise UsageError(f"layer '{path}': only an affine instance norm can be exported")
    return "instance_norm", {"weight": "", "bias": "", "eps": module.eps}


def _upsample(path: str, module: nn.Upsample) -> tuple[str, Node]:
    scale = module.scale_factor
    if module.mode != "nearest" or scale is None or scale != int(scale):
        raise UsageError(f"layer '{path}': only nearest upsampling by a whole number is exported")
    return "upsample_nearest", {"scale": int(scale)}


_MODULES: dict[type, Any] = {
    nn.Conv2d: _convolution,
    nn.ConvTranspose2d: _convolution,
    nn.BatchNorm2d: _batch_norm,
    nn.InstanceNorm2d: _instance_norm,
    nn.LeakyReLU: lambda path, module: ("leaky_relu", {"slope": module.negative_slope}),
    nn.ReLU: lambda path, module: ("relu", {}),
    nn.Sigmoid: lambda path, module: ("sigmoid", {}),
    nn.Tanh: lambda path, module: ("tanh", {}),
    nn.Upsample: _upsample,
}


def run_graph(
    nodes: list[Node], result: str, weights: Mapping[str, torch.Tensor], buffers: torch.Tensor
) -> dict[str, torch.Tensor]:
    """Every node's output by name for encoded buffers (B, C, H, W), by the graph alone; for parity tests.

    The picture is outputs[result]. Raises InputError for a node that is not of the format.
    """
    outputs: dict[str, torch.Tensor] = {INPUT: buffers}
    for node in nodes:
        try:
            inputs = [outputs[name] for name in node["inputs"]]
            tensors = {
                key: None if node.get(key) is None else weights[node[key]]
                for key in ("weight", "bias", "running_mean", "running_var")
            }
            outputs[node["name"]] = _run_node(node, inputs, tensors)
        except (KeyError, RuntimeError) as error:
            raise InputError(f"node '{node.get('name')}': {error}") from error
    if result not in outputs:
        raise InputError(f"the result '{result}' is no node")
    return outputs


def _run_node(
    node: Node, x: list[torch.Tensor], t: Mapping[str, torch.Tensor | None]
) -> torch.Tensor:
    op = node["op"]
    if op in ("conv2d", "conv_transpose2d"):
        function = getattr(functional, op)
        return function(x[0], t["weight"], t["bias"], node["stride"], node["padding"])
    if op == "batch_norm":
        return functional.batch_norm(
            x[0], t["running_mean"], t["running_var"], t["weight"], t["bias"], eps=node["eps"]
        )
    if op == "instance_norm":
        return functional.instance_norm(x[0], weight=t["weight"], bias=t["bias"], eps=node["eps"])
    if op == "leaky_relu":
        return functional.leaky_relu(x[0], node["slope"])
    if op in ("relu", "sigmoid", "tanh"):
        return getattr(torch, op)(x[0])
    if op == "concat":
        return torch.cat(x, 1)
    if op == "add":
        return x[0] + x[1]
    if op == "mul":
        return x[0] * x[1]
    if op == "slice_channels":
        return x[0][:, node["first"] : node["first"] + node["count"]]
    if op == "upsample_nearest":
        return functional.interpolate(x[0], scale_factor=node["scale"], mode="nearest")
    raise InputError(f"node '{node['name']}': unknown operation '{op}'")


@dataclass(frozen=True)
class ExportedGenerator:
    """A generator read back from a run folder, executed by run_graph()."""

    schema: Schema
    nodes: list[Node]
    result: str
    multiple: int
    weights: Weights
    weights_version: str
    training: dict[str, Any]

    @torch.no_grad()
    def draw(self, sample: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Linear radiance (3, H, W), or (B, 3, H, W), from linear buffers of any size."""
        buffers = self.schema.encode_inputs(sample)
        single = buffers.dim() == 3
        buffers = buffers[None] if single else buffers
        height, width = buffers.shape[-2:]
        padded = pad_to_multiple(buffers, self.multiple)
        image = run_graph(self.nodes, self.result, self.weights, padded)[self.result]
        image = self.schema.decode_output(image[..., :height, :width])
        return image[0] if single else image


def padded_side(side: int, multiple: int) -> int:
    """The least multiple that is not below `side`."""
    return side + -side % multiple


def pad_to_multiple(buffers: torch.Tensor, multiple: int) -> torch.Tensor:
    """Repeats the last row and column of (..., C, H, W) until both sides are multiples; the caller crops the result."""
    height, width = buffers.shape[-2:]
    right, bottom = padded_side(width, multiple) - width, padded_side(height, multiple) - height
    if not (right or bottom):
        return buffers
    return functional.pad(buffers, (0, right, 0, bottom), mode="replicate")


def export_generator(
    folder: str | Path, generator: nn.Module, schema: Schema, training: dict[str, Any]
) -> str:
    """Writes the three files into `folder`, each whole or not at all, the manifest last. Returns the weights' version.

    `training` is the provenance: any JSON. Raises UsageError for a module that is not of OPS, RunError if a file cannot
    be written.
    """
    from safetensors.torch import save

    folder = Path(folder)
    was_training = generator.training
    generator.eval()
    try:
        nodes, result, weights = trace_graph(generator)
    finally:
        generator.train(was_training)
    blob = save(weights, metadata={"format": "pt"})
    version = hash_bytes(blob)
    record = {
        "format": FORMAT,
        "version": VERSION,
        "weights": {"file": WEIGHTS_FILE, "xxh3_128": version},
        **schema.to_json(),
        "multiple": int(getattr(generator, "multiple", 1)),
        "nodes": nodes,
        "result": result,
        "training": training,
    }
    text = (json.dumps(record, indent=1, allow_nan=False) + "\n").encode()
    write_atomic(folder / WEIGHTS_FILE, blob)
    write_atomic(folder / GRAPH_FILE, text)
    write_manifest(folder, {WEIGHTS_FILE: version, GRAPH_FILE: hash_bytes(text)})
    return version


def load_generator(folder: str | Path) -> ExportedGenerator:
    """Reads an exported generator; every checksum is compared before anything is parsed. Raises InputError."""
    from safetensors import SafetensorError
    from safetensors.torch import load

    folder = Path(folder)
    verify_manifest(folder, (GRAPH_FILE, WEIGHTS_FILE))
    name = str(folder / GRAPH_FILE)
    try:
        record = json.loads(read_bytes(folder / GRAPH_FILE))
        if (record["format"], record["version"]) != (FORMAT, VERSION):
            raise ValueError(f"format {record['format']} {record['version']} is not {FORMAT} 1")
        blob = read_bytes(folder / WEIGHTS_FILE)
        if record["weights"]["xxh3_128"] != hash_bytes(blob):
            raise ValueError(f"{WEIGHTS_FILE} is not the file that belongs to it")
        return ExportedGenerator(
            schema=Schema.from_json(record, name),
            nodes=record["nodes"],
            result=record["result"],
            multiple=int(record["multiple"]),
            weights=load(blob),
            weights_version=record["weights"]["xxh3_128"],
            training=record.get("training", {}),
        )
    except KeyError as error:
        raise InputError(f"{name}: missing key {error}") from error
    except (TypeError, ValueError, SafetensorError) as error:
        raise InputError(f"{name}: {error}") from error
