"""The options of a training run, with their defaults and bounds.

SPDX-License-Identifier: BSD-3-Clause

The command line shows the defaults in its help: torch is not loaded before an option is checked.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pave.checks import UINT64_MAX, whole
from pave.errors import UsageError

if TYPE_CHECKING:
    from pave.models import GeneratorOptions

DEFAULT_INPUTS = ("albedo", "direct", "normal", "depth")
BEST_METRICS = ("psnr", "ssim", "l1")


@dataclass(frozen=True)
class TrainOptions:
    """All that decides how a run goes. The same options, data and machine give the same weights."""

    inputs: tuple[str, ...] = DEFAULT_INPUTS
    repeat_depth: int = 1  # 3: depth as an image of three planes, the papers' 12 + 3 = 15
    epochs: int = 40
    minutes: float | None = None  # instead of `epochs`: as many as a short trial says will fit
    batch: int = 2
    lr: float = 5e-4
    d_lr: float = 1e-3  # the discriminator's, which has less to learn from
    beta1: float = 0.5
    beta2: float = 0.999
    l1_weight: float = 260.0
    adversarial_weight: float = 1.0
    gan_mode: str = "bce"
    filters: int = 24
    unet_depth: int = 5
    norm: str = "none"
    head: str = "residual"
    refine: int = 1
    d_filters: int = 16
    d_layers: int = 3
    d_norm: str = "none"  # of the same images: drawn and path traced batches have other statistics
    ema_decay: float = 0.998
    mirror: bool = False  # half of the images mirrored, with their normals
    best: str = "psnr"
    seed: int = 0
    deterministic: bool = False
    device: str = "auto"
    threads: int = 0  # 0: torch's own choice
    checkpoint_steps: int = 0  # 0: at every epoch's end only
    checkpoint_seconds: float = 60.0  # 0: never because of time
    cache_bytes: int = 4 << 30  # encoded images up to this size are kept in memory

    @property
    def generator(self) -> GeneratorOptions:
        from pave.models import GeneratorOptions

        return GeneratorOptions(self.filters, self.unet_depth, self.norm, self.head, self.refine)

    def to_json(self) -> dict[str, Any]:
        return {**dataclasses.asdict(self), "inputs": list(self.inputs)}

    @staticmethod
    def from_json(record: Mapping[str, Any]) -> TrainOptions:
        """Options from a dict such as the command line's. Raises UsageError for a name or value that is none."""
        known = {item.name for item in dataclasses.fields(TrainOptions)}
        for name in record:
            if name not in known:
                raise UsageError(f"unknown training option '{name}'")
        values = dict(record)
        if "inputs" in values:
            values["inputs"] = tuple(values["inputs"])
        options = TrainOptions(**values)
        options.check()
        return options

    def check(self) -> None:
        """Raises UsageError for a value out of bounds."""
        from pave.losses import GAN_MODES
        from pave.models import NORMS
        from pave.schema import check_channels

        check_channels(self.inputs)
        self.generator.check()
        bounds = {
            "epochs": (1, 1_000_000),
            "batch": (1, 4096),
            "lr": (0.0, 1.0),
            "d_lr": (0.0, 1.0),
            "beta1": (0.0, 0.9999),
            "beta2": (0.0, 0.999999),
            "l1_weight": (0.0, 1e6),
            "adversarial_weight": (0.0, 1e6),
            "d_filters": (1, 1024),
            "d_layers": (1, 6),
            "ema_decay": (0.0, 0.999999),
            "repeat_depth": (1, 3),
            "threads": (0, 1024),
            "checkpoint_steps": (0, 10**9),
            "checkpoint_seconds": (0.0, 1e9),
        }
        whole("seed", self.seed, 0, UINT64_MAX)
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise UsageError(f"{name} {value} is outside {low:g}..{high:g}")
        if self.lr == 0:
            raise UsageError("lr must be above 0")
        if self.l1_weight == 0 and self.adversarial_weight == 0:
            raise UsageError("l1_weight and adversarial_weight are both 0: nothing to learn from")
        if self.minutes is not None and not 0 < self.minutes <= 1e6:
            raise UsageError(f"minutes {self.minutes} is not above 0")
        for name, allowed in (
            ("gan_mode", GAN_MODES),
            ("d_norm", NORMS),
            ("best", BEST_METRICS),
            ("device", ("auto", "cpu", "cuda")),
        ):
            if getattr(self, name) not in allowed:
                raise UsageError(
                    f"{name} '{getattr(self, name)}' is not one of {', '.join(allowed)}"
                )
        if self.head == "residual" and "direct" not in self.inputs:
            raise UsageError(
                "head 'residual' adds to the channel 'direct': name it in the inputs, or take head 'sigmoid'"
            )
