"""What is measured: PAVE and Mitsuba, each with the same scene file, size and number of samples.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import pave
from pave.bench.common import Bench, Mean

SIX = ("color", "albedo", "direct", "normal", "depth", "variance")
MITSUBA = "mitsuba llvm_ad_rgb"
HOW_TO_GET = "`pip install mitsuba` and `apt install libllvm19`"


class Pave:
    """A scene file on PAVE's device, with one frame that every render goes to."""

    def __init__(
        self, device: pave.Device, path: Path | str, size: int, channels: Sequence[str]
    ) -> None:
        self.scene = pave.load_scene(path, defines={"size": size})
        self.renderer = pave.Renderer(device, self.scene)
        self.stage = pave.Stage(
            device, "mem:", width=size, height=size, channels=list(channels), slots=1
        )
        self.frame = self.stage.acquire()

    def render(self, spp: int, seed: int = 0, **options: Any) -> np.ndarray:
        """Color as (3, H, W): a view of the frame until the next render."""
        self.renderer.render(None, self.frame, spp=spp, seed=seed, **options)
        return self.frame["color"].numpy()


class Mitsuba:
    """The same file in Mitsuba. Make it with `Mitsuba.find`."""

    name, label = "Mitsuba", MITSUBA

    def __init__(self, module: Any) -> None:
        self.module = module

    @classmethod
    def find(cls, bench: Bench) -> Mitsuba | None:
        """None, with a line that says how to get it, where it is missing or was not asked for."""
        if not bench.options.peers:
            return None
        libraries = glob.glob("/usr/lib/*/libLLVM.so.*") + glob.glob("/usr/lib/*/libLLVM-1[5-9]*")
        if libraries:
            os.environ.setdefault("DRJIT_LIBLLVM_PATH", max(libraries))
        try:
            import mitsuba

            mitsuba.set_variant("llvm_ad_rgb")
            mitsuba.Float(1.0) + 1.0  # loads LLVM
        except Exception as error:
            reason = " ".join(str(error).split())
            bench.remark(
                f"no Mitsuba ({reason}): get it by {HOW_TO_GET}; PAVE's figures stand alone"
            )
            return None
        mitsuba.set_log_level(mitsuba.LogLevel.Error)
        return cls(mitsuba)

    def load(self, path: Path, size: int, spp: int) -> Any:
        return self.module.load_file(str(path), size=str(size), spp=str(spp))

    def render(self, scene: Any, spp: int, seed: int = 0, **options: Any) -> np.ndarray:
        """The image as (C, H, W), evaluated."""
        image = self.module.render(scene, spp=spp, seed=seed, **options)
        return np.moveaxis(np.array(image, dtype=np.float32), 2, 0)

    def mean(self, scene: Any, spp: int, runs: int = 8) -> Mean:
        """Of images with seeds that no round uses."""
        return Mean.of_runs([self.render(scene, spp, 1000 + run) for run in range(runs)])


def independent_mean(device: pave.Device, path: Path, size: int, spp: int, **options: Any) -> Mean:
    """Mean of PAVE's color with independent samples, whose variance is exactly the error's."""
    subject = Pave(device, path, size, ("color", "variance"))
    color = subject.render(spp, 1000, sampler="independent", **options)
    return Mean.of_variance(color, subject.frame["variance"].numpy())
