"""Writes the fixtures of tests/host/nn: small networks, inputs, and what torch makes of them in double precision.

SPDX-License-Identifier: BSD-3-Clause

Run from anywhere: `python tests/data/nn/make_fixtures.py`. Nothing here comes from PAVE: each network is executed by
torch.nn.functional node by node, so the stored values are an oracle of their own. Same torch, same bytes.

fixtures.json: {"cases": [{"name", "width", "height", "inputs", "layers", "document"}]}; `document` is a generator.json,
`inputs` how many inputs there are, `layers` for how many of them every node's output is stored.
fixtures.safetensors: weights as the documents name them, "NAME/in/I", "NAME/out/I/NODE".
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from safetensors.torch import save_file

FOLDER = Path(__file__).resolve().parent
SEED = 20240229
generator = torch.Generator().manual_seed(SEED)


def normal(*shape: int, scale: float = 1.0, shift: float = 0.0) -> torch.Tensor:
    return torch.randn(*shape, generator=generator) * scale + shift


class Net:
    """A graph being written: every method adds a node and returns its name."""

    def __init__(self, name: str, planes: int):
        self.name, self.planes = name, planes
        self.nodes: list[dict[str, Any]] = []
        self.weights: dict[str, torch.Tensor] = {}
        self.channels = {"input": planes}

    def node(self, op: str, inputs: list[str], channels: int, name: str = "", **keys: Any) -> str:
        name = name or f"n{len(self.nodes)}.{op}"
        self.nodes.append({"name": name, "op": op, "inputs": inputs, **keys})
        self.channels[name] = channels
        return name

    def tensor(self, key: str, value: torch.Tensor) -> str:
        full = f"{self.name}/weights/{len(self.nodes)}.{key}"
        self.weights[full] = value.contiguous()
        return full

    def conv(self, x: str, planes: int, k: int, stride=1, padding=0, bias=True, kw=None) -> str:
        ins = self.channels[x]
        weight = normal(planes, ins, k, kw or k, scale=(1.0 / (ins * k * k)) ** 0.5)
        return self.node(
            "conv2d",
            [x],
            planes,
            weight=self.tensor("weight", weight),
            bias=self.tensor("bias", normal(planes)) if bias else None,
            stride=stride,
            padding=padding,
        )

    def conv_t(self, x: str, planes: int, k: int, stride=1, padding=0, bias=True) -> str:
        ins = self.channels[x]
        weight = normal(ins, planes, k, k, scale=(stride * stride / (ins * k * k)) ** 0.5)
        return self.node(
            "conv_transpose2d",
            [x],
            planes,
            weight=self.tensor("weight", weight),
            bias=self.tensor("bias", normal(planes)) if bias else None,
            stride=stride,
            padding=padding,
        )

    def batch_norm(self, x: str, affine: bool = True) -> str:
        c = self.channels[x]
        return self.node(
            "batch_norm",
            [x],
            c,
            weight=self.tensor("weight", normal(c, scale=0.3, shift=1.0)) if affine else None,
            bias=self.tensor("bias", normal(c, scale=0.3)) if affine else None,
            running_mean=self.tensor("mean", normal(c, scale=0.5)),
            running_var=self.tensor("var", normal(c).square() + 0.1),
            eps=1e-5,
        )

    def instance_norm(self, x: str, affine: bool = True) -> str:
        c = self.channels[x]
        return self.node(
            "instance_norm",
            [x],
            c,
            weight=self.tensor("weight", normal(c, scale=0.3, shift=1.0)) if affine else None,
            bias=self.tensor("bias", normal(c, scale=0.3)) if affine else None,
            eps=1e-5,
        )

    def leaky_relu(self, x: str, slope: float = 0.2) -> str:
        return self.node("leaky_relu", [x], self.channels[x], slope=slope)

    def unary(self, op: str, x: str) -> str:
        return self.node(op, [x], self.channels[x])

    def concat(self, *xs: str) -> str:
        return self.node("concat", list(xs), sum(self.channels[x] for x in xs))

    def binary(self, op: str, a: str, b: str) -> str:
        return self.node(op, [a, b], self.channels[a])

    def slice(self, x: str, first: int, count: int) -> str:
        return self.node("slice_channels", [x], count, first=first, count=count)

    def upsample(self, x: str, scale: int) -> str:
        return self.node("upsample_nearest", [x], self.channels[x], scale=scale)

    def execute(self, image: torch.Tensor) -> dict[str, torch.Tensor]:
        """Every node's output (C, H, W) in double precision."""
        values = {"input": image.double()[None]}
        weights = {name: value.double() for name, value in self.weights.items()}

        def named(node: dict[str, Any], key: str) -> torch.Tensor | None:
            return None if node.get(key) is None else weights[node[key]]

        for node in self.nodes:
            x = [values[name] for name in node["inputs"]]
            weight, bias = named(node, "weight"), named(node, "bias")
            match node["op"]:
                case "conv2d":
                    y = F.conv2d(x[0], weight, bias, node["stride"], node["padding"])
                case "conv_transpose2d":
                    y = F.conv_transpose2d(x[0], weight, bias, node["stride"], node["padding"])
                case "batch_norm":
                    mean, var = named(node, "running_mean"), named(node, "running_var")
                    y = F.batch_norm(x[0], mean, var, weight, bias, False, 0.0, node["eps"])
                case "instance_norm":
                    y = F.instance_norm(x[0], weight=weight, bias=bias, eps=node["eps"])
                case "leaky_relu":
                    y = F.leaky_relu(x[0], node["slope"])
                case "relu" | "sigmoid" | "tanh":
                    y = getattr(torch, node["op"])(x[0])
                case "concat":
                    y = torch.cat(x, 1)
                case "add":
                    y = x[0] + x[1]
                case "mul":
                    y = x[0] * x[1]
                case "slice_channels":
                    y = x[0][:, node["first"] : node["first"] + node["count"]]
                case "upsample_nearest":
                    y = F.interpolate(x[0], scale_factor=node["scale"], mode="nearest")
            values[node["name"]] = y
        return {name: value[0].float().contiguous() for name, value in values.items()}


class Fixtures:
    def __init__(self) -> None:
        self.cases: list[dict[str, Any]] = []
        self.tensors: dict[str, torch.Tensor] = {}

    def add(self, net: Net, width: int, height: int, inputs=1, layers=1, result="", shift=0.0):
        if (
            not result
        ):  # the schema wants an image of the input's size: tests of single ops look at the layers
            result = net.slice("input", 0, 1)
        self.tensors.update(net.weights)
        for i in range(inputs):
            image = normal(net.planes, height, width, shift=shift)
            outputs = net.execute(image)
            self.tensors[f"{net.name}/in/{i}"] = image
            for name, value in outputs.items():
                if (i < layers and name != "input") or name == result:
                    self.tensors[f"{net.name}/out/{i}/{name}"] = value.clone()
        document = {
            "format": "pave-generator",
            "version": 1,
            "weights": {"file": "generator.safetensors", "xxh3_128": "0" * 32},
            "inputs": [{"channel": "any", "planes": net.planes, "encode": "unit"}],
            "transfer": {"name": "srgb_log", "peak": 4.0},
            "output": {"channel": "color", "planes": net.channels[result], "decode": "radiance"},
            "multiple": 32,
            "nodes": net.nodes,
            "result": result,
        }
        self.cases.append(
            {
                "name": net.name,
                "width": width,
                "height": height,
                "inputs": inputs,
                "layers": layers,
                "document": document,
            }
        )


def add_convolutions(fixtures: Fixtures) -> None:
    # name: planes in, out, kernel, stride, padding, width, height
    plain = {
        "k3s1p1": (5, 7, 3, 1, 1, 13, 11),
        "k4s2p1": (3, 20, 4, 2, 1, 7, 9),
        "k1": (17, 33, 1, 1, 0, 5, 3),
        "k7p3": (2, 3, 7, 1, 3, 6, 5),
        "k5s3": (4, 8, 5, 3, 0, 17, 14),
        "k2s2": (8, 16, 2, 2, 0, 6, 10),
        "one_pixel": (12, 24, 3, 1, 1, 1, 1),
        "wide": (60, 40, 3, 1, 1, 5, 5),
        "narrow": (1, 1, 3, 2, 1, 9, 2),
        "far_padding": (3, 4, 3, 1, 5, 3, 4),
    }
    for name, (ins, outs, k, s, p, w, h) in plain.items():
        net = Net(f"conv_{name}", ins)
        net.conv("input", outs, k, s, p, bias=name != "k5s3")
        fixtures.add(net, w, h)
    transposed = {
        "k4s2p1": (6, 10, 4, 2, 1, 5, 4),
        "k3s2p1": (5, 8, 3, 2, 1, 4, 3),
        "k2s2": (16, 3, 2, 2, 0, 3, 5),
        "k3s1p1": (4, 9, 3, 1, 1, 5, 6),
        "k5s3p2": (3, 17, 5, 3, 2, 4, 3),
        "k2s3": (3, 4, 2, 3, 0, 3, 2),
        "one_pixel": (20, 12, 4, 2, 1, 1, 1),
        "k1s2p0": (4, 5, 1, 2, 0, 3, 3),
    }
    for name, (ins, outs, k, s, p, w, h) in transposed.items():
        net = Net(f"conv_t_{name}", ins)
        net.conv_t("input", outs, k, s, p, bias=name != "k5s3p2")
        fixtures.add(net, w, h)
    net = Net("conv_oblong", 3)
    net.conv("input", 6, 3, 1, 1, kw=5)
    fixtures.add(net, 9, 8)


def add_norms(fixtures: Fixtures) -> None:
    net = Net("norm_folded", 6)
    x = net.batch_norm(net.conv("input", 10, 3, 1, 1, bias=False))
    x = net.leaky_relu(x)
    x = net.batch_norm(net.conv_t(x, 5, 4, 2, 1))
    net.batch_norm(net.unary("relu", x), affine=False)
    fixtures.add(net, 7, 5)

    net = Net("norm_of_shared_conv", 4)  # two readers: must not be folded
    conv = net.conv("input", 9, 3, 1, 1)
    net.binary("add", net.batch_norm(conv), conv)
    fixtures.add(net, 6, 6)

    net = Net("norm_of_input", 11)
    net.unary("tanh", net.batch_norm("input"))
    fixtures.add(net, 5, 7)

    for affine in (True, False):
        net = Net(f"instance_{'affine' if affine else 'plain'}", 19)
        net.leaky_relu(net.instance_norm("input", affine), 0.1)
        fixtures.add(net, 9, 7)
    net = Net("instance_far_from_zero", 3)  # a naive E[x^2] - E[x]^2 loses everything here
    net.instance_norm("input")
    fixtures.add(net, 48, 40, shift=300.0)
    net = Net(
        "instance_chunks", 2
    )  # more pixels than one chunk of the kernel, and a last chunk that is not full
    net.instance_norm("input")
    fixtures.add(net, 67, 33)


def add_joins(fixtures: Fixtures) -> None:
    net = Net("unary", 7)
    for op in ("relu", "sigmoid", "tanh"):
        net.unary(op, "input")
    net.leaky_relu("input", -0.5)
    net.unary("tanh", net.unary("relu", net.unary("sigmoid", net.leaky_relu("input"))))
    fixtures.add(net, 5, 3)

    net = Net("joins", 6)
    a = net.conv("input", 6, 3, 1, 1)
    b = net.unary("relu", a)
    c = net.binary("mul", a, "input")
    net.binary("add", c, c)
    d = net.concat(a, b, a)
    e = net.slice(d, 4, 9)
    f = net.concat(e, "input", net.unary("tanh", d))
    g = net.leaky_relu(f)
    net.binary("mul", net.slice(g, 1, 6), net.slice(g, 2, 6))
    fixtures.add(net, 5, 4)

    net = Net(
        "hazards", 4
    )  # in-place and shared memory, in the orders that go wrong when liveness is wrong
    a = net.conv("input", 4, 1)
    b = net.conv("input", 4, 1)
    joined = net.concat(a, b)
    r = net.unary("relu", joined)  # may not overwrite a: it is read below
    s = net.binary("add", a, net.slice(r, 0, 4))
    t = net.slice(s, 1, 2)
    u = net.unary("sigmoid", s)
    net.concat(t, u, net.unary("tanh", t))
    v = net.concat(net.concat(net.conv("input", 3, 1), net.conv("input", 2, 1)), b)
    net.binary("add", v, net.leaky_relu(v))
    fixtures.add(net, 3, 3)

    net = Net("upsample", 5)
    x = net.upsample("input", 2)
    x = net.upsample(net.conv(x, 3, 3, 1, 1), 3)
    net.unary("relu", x)
    fixtures.add(net, 5, 3)


def add_unet(fixtures: Fixtures, norm: str) -> None:
    net = Net(f"unet_{norm}", 10)
    normalise = net.batch_norm if norm == "batch" else net.instance_norm
    widths = [8, 12, 16, 16]
    x, skips = "input", []
    for level, width in enumerate(widths):
        x = net.conv(x, width, 4, 2, 1, bias=level == 0)
        x = net.leaky_relu(normalise(x) if 0 < level < len(widths) - 1 else x)
        skips.append(x)
    skips.pop()
    for width in reversed(widths[:-1]):
        x = net.unary("relu", normalise(net.conv_t(x, width, 4, 2, 1, bias=False)))
        x = net.concat(x, skips.pop())
    x = net.concat(net.leaky_relu(net.conv_t(x, 8, 4, 2, 1)), "input")
    x = net.conv(net.leaky_relu(net.conv(x, 8, 3, 1, 1)), 3, 3, 1, 1)
    result = net.binary("add", x, net.slice("input", 3, 3))
    fixtures.add(net, 16, 32, inputs=10, layers=1, result=result)


def main() -> None:
    fixtures = Fixtures()
    add_convolutions(fixtures)
    add_norms(fixtures)
    add_joins(fixtures)
    for norm in ("batch", "instance"):
        add_unet(fixtures, norm)
    save_file(fixtures.tensors, FOLDER / "fixtures.safetensors")
    document = {"torch": torch.__version__.split("+")[0], "cases": fixtures.cases}
    (FOLDER / "fixtures.json").write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
