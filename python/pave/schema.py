"""What a network's numbers mean: which channels it reads, how each is encoded, and how its output becomes radiance.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from pave import transfer
from pave.errors import InputError, UsageError

ENCODINGS = {
    "albedo": "unit",
    "direct": "radiance",
    "color": "radiance",
    "variance": "radiance",
    "normal": "signed",
    "depth": "depth",
    "distance": "depth",
    "position": "position",
}
PLANES = {"depth": 1, "distance": 1}  # three where nothing is said
TARGET = "color"

Sample = Mapping[str, torch.Tensor]


@dataclass(frozen=True)
class InputSpec:
    """One input channel: `planes` of the frame, encoded, then the group of planes `repeat` times over."""

    channel: str
    planes: int
    encode: str
    repeat: int = 1
    scale: float = 1.0  # "depth"
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)  # "position"
    radius: float = 1.0  # "position"

    def to_json(self) -> dict[str, Any]:
        record: dict[str, Any] = {
            "channel": self.channel,
            "planes": self.planes,
            "encode": self.encode,
            "repeat": self.repeat,
        }
        if self.encode == "depth":
            record["scale"] = self.scale
        if self.encode == "position":
            record["center"], record["radius"] = list(self.center), self.radius
        return record

    def encoded(self, planes: torch.Tensor, peak: float) -> torch.Tensor:
        """(..., planes, H, W) linear -> (..., planes * repeat, H, W) for the network."""
        if self.encode == "radiance":
            planes = transfer.encode_radiance(planes, peak)
        elif self.encode == "depth":
            planes = transfer.encode_depth(planes, self.scale)
        elif self.encode == "position":
            planes = transfer.encode_position(planes, list(self.center), self.radius)
        return planes if self.repeat == 1 else torch.cat([planes] * self.repeat, -3)


@dataclass(frozen=True)
class Schema:
    """Everything between a frame and the network. Fixed for a run; travels with the weights."""

    inputs: tuple[InputSpec, ...]
    peak: float = 1.0
    output_planes: int = field(default=3)

    @property
    def in_planes(self) -> int:
        return sum(spec.planes * spec.repeat for spec in self.inputs)

    @property
    def channels(self) -> list[str]:
        return [spec.channel for spec in self.inputs]

    def first_plane(self, channel: str) -> int | None:
        """Where `channel` begins in the network's input; None if it is not an input."""
        first = 0
        for spec in self.inputs:
            if spec.channel == channel:
                return first
            first += spec.planes * spec.repeat
        return None

    def encode_inputs(self, sample: Sample) -> torch.Tensor:
        """Dict of (..., C, H, W) by channel -> (..., in_planes, H, W). Raises InputError for what does not fit."""
        planes = []
        for spec in self.inputs:
            if spec.channel not in sample:
                raise UsageError(
                    f"missing input: {spec.channel} (there are {', '.join(sorted(sample))})"
                )
            tensor = sample[spec.channel]
            if tensor.shape[-3] != spec.planes:
                raise InputError(
                    f"channel '{spec.channel}' has {tensor.shape[-3]} planes, "
                    f"the network was made for {spec.planes}"
                )
            planes.append(spec.encoded(tensor.float(), self.peak))
        return torch.cat(planes, -3)

    def encode_target(self, sample: Sample) -> torch.Tensor:
        """The encoded `color`. Raises UsageError if there is none."""
        if TARGET not in sample:
            raise UsageError(f"missing channel: {TARGET} (there are {', '.join(sorted(sample))})")
        return transfer.encode_radiance(sample[TARGET].float(), self.peak)

    def decode_output(self, encoded: torch.Tensor) -> torch.Tensor:
        """The network's output -> linear radiance."""
        return transfer.decode_radiance(encoded, self.peak)

    def to_json(self) -> dict[str, Any]:
        """The part of generator.json that is about numbers, not layers."""
        return {
            "inputs": [spec.to_json() for spec in self.inputs],
            "transfer": {"name": transfer.NAME, "peak": self.peak},
            "output": {"channel": TARGET, "planes": self.output_planes, "decode": "radiance"},
        }

    @staticmethod
    def from_json(record: Mapping[str, Any], name: str) -> Schema:
        """Inverse of to_json(). Raises InputError that names `name` and what is wrong there."""
        try:
            if record["transfer"]["name"] != transfer.NAME:
                raise ValueError(f"unknown transfer '{record['transfer']['name']}'")
            specs = []
            for item in record["inputs"]:
                if item["encode"] not in set(ENCODINGS.values()):
                    raise ValueError(f"unknown encoding '{item['encode']}'")
                values = dict(item)
                if "center" in values:
                    values["center"] = tuple(float(x) for x in values["center"])
                specs.append(InputSpec(**values))
            return Schema(
                tuple(specs),
                float(record["transfer"]["peak"]),
                int(record["output"]["planes"]),
            )
        except KeyError as error:
            raise InputError(f"{name}: missing key {error}") from error
        except (TypeError, ValueError) as error:
            raise InputError(f"{name}: {error}") from error


def fit_schema(
    samples: Iterable[Sample], channels: Sequence[str], *, repeat_depth: int = 1
) -> Schema:
    """Schema whose scales come from `samples` (the training split): peak radiance, median depth, bounds of positions.

    `repeat_depth` 3 gives the papers' stack, in which depth was an image of three planes like the others.
    Raises UsageError for channels that a network cannot read, InputError for data without a number in them.
    """
    check_channels(channels)
    peak, depths, low, high = 1.0, [], None, None
    for sample in samples:
        for channel in (*channels, TARGET):
            if channel not in sample:
                raise UsageError(
                    f"missing channel: {channel} (there are {', '.join(sorted(sample))})"
                )
            values = sample[channel]
            encoding = ENCODINGS[channel]
            if encoding == "radiance":
                peak = max(peak, float(values.max()))
            elif encoding == "depth":
                depths.append(_median_of_finite(values))
            elif encoding == "position":
                points = values.flatten(-2)[..., torch.isfinite(values).all(-3).flatten()]
                if points.numel():
                    low = _merge(torch.minimum, low, points.amin(-1))
                    high = _merge(torch.maximum, high, points.amax(-1))
    finite = [depth for depth in depths if depth == depth]
    scale = float(torch.tensor(finite).median()) if finite else 1.0
    center, radius = (0.0, 0.0, 0.0), 1.0
    if low is not None and high is not None:
        middle = (low + high) / 2
        center = tuple(float(x) for x in middle)
        radius = max(float((high - low).norm()) / 2, 1e-6)
    specs = []
    for channel in channels:
        encoding = ENCODINGS[channel]
        specs.append(
            InputSpec(
                channel,
                PLANES.get(channel, 3),
                encoding,
                repeat_depth if encoding == "depth" else 1,
                scale if encoding == "depth" else 1.0,
                center if encoding == "position" else (0.0, 0.0, 0.0),
                radius if encoding == "position" else 1.0,
            )
        )
    return Schema(tuple(specs), peak)


def check_channels(channels: Sequence[str]) -> None:
    """Raises UsageError unless these can be inputs of a network."""
    if not channels:
        raise UsageError("a network needs at least one input channel")
    for channel in channels:
        if channel == TARGET:
            raise UsageError(f"'{TARGET}' is what the network is to draw, it cannot be an input")
        if channel not in ENCODINGS:
            known = ", ".join(name for name in ENCODINGS if name != TARGET)
            raise UsageError(f"channel '{channel}' cannot be an input; there are {known}")
    if len(set(channels)) != len(channels):
        raise UsageError("an input channel is named twice")


def _median_of_finite(values: torch.Tensor) -> float:
    finite = values[torch.isfinite(values)]
    return float(finite.median()) if finite.numel() else float("nan")


def _merge(choose: Any, so_far: torch.Tensor | None, values: torch.Tensor) -> torch.Tensor:
    return values if so_far is None else choose(so_far, values)
