"""Draws views of a data set in the renderer, and compares with torch, with path tracing, and with path tracing of equal time.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pave.errors import RunError
from pave.inference import DRAWING_SPP, cheap_depth

if TYPE_CHECKING:
    import torch

    import pave
    from pave.data import Dataset
    from pave.schema import Sample


class DrawnViews:
    """Views of `test`, the test split of a rendered set of `scene`, drawn by the generator of `run` on one device."""

    def __init__(
        self, device: pave.Device, scene: pave.Scene, run: Path, test: Dataset, figures: Path
    ) -> None:
        import pave
        from pave.export import load_generator

        self.scene, self.test, self.figures = scene, test, figures
        self.renderer = pave.Renderer(device, scene)
        self.generator = pave.Generator(device, run)
        self.in_torch = load_generator(run)
        size = {"width": test[0]["color"].shape[-1], "height": test[0]["color"].shape[-2]}
        channels = [*self.generator.inputs, "drawn"]
        self.buffers = pave.Stage(device, "mem:", channels=channels, slots=1, **size)
        self.image = pave.Stage(device, "mem:", channels=["color"], slots=1, **size)

    def draw(self, count: int, on_view: Callable[[int, int], None]) -> dict[str, Any]:
        """Draws the first `count` views. Means of PSNR, medians of times; the first view pays for compiling kernels.

        "as_trained" draws from the buffers that the data set has; "fast" from ones of DRAWING_SPP samples, beside a path
        traced image that was given the same time. Raises RunError if a cheap pass does not give the data set's buffers.
        """
        rows = []
        count = min(count, len(self.test))
        for index in range(count):
            truth = self.test[index]  # read and verified once
            rows.append({**self._as_trained(index, truth), **self._fast(index, truth["color"])})
            on_view(index + 1, count)

        def mean(key: str) -> float:
            return statistics.mean(row[key] for row in rows)

        def median_ms(key: str) -> float:
            return 1e3 * statistics.median(row[key] for row in (rows[1:] or rows))

        return {
            "views": len(rows),
            "same_buffers": True,  # else it was raised
            "torch_difference": max(row["torch_difference"] for row in rows),
            "psnr": mean("psnr"),
            "buffers_ms": median_ms("buffers_seconds"),
            "network_ms": median_ms("network_seconds"),
            "path_traced_ms": median_ms("path_traced_seconds"),
            "fast": {
                "spp": DRAWING_SPP,
                "psnr": mean("fast_psnr"),
                "ms": median_ms("fast_seconds"),
                "equal_time_path_traced": {
                    "spp": round(mean("equal_spp")),
                    "psnr": mean("equal_psnr"),
                    "ms": median_ms("equal_seconds"),
                },
            },
        }

    def _render(
        self, stage: pave.Stage, index: int, spp: int, depth: int, seed: int
    ) -> tuple[pave.Frame, float]:
        """View `index` into a frame of `stage`, and the seconds that it took."""
        frame = stage.acquire()
        begin = time.perf_counter()
        self.renderer.render(
            self.test.frame(index).view,
            frame,
            spp=spp,
            max_depth=depth,
            seed=seed,
            frame_index=self.test.metadata(index)["index"],
        )
        return frame, time.perf_counter() - begin

    def _as_trained(self, index: int, truth: Sample) -> dict[str, float]:
        import numpy as np

        from pave.image import write_png
        from pave.metrics import psnr
        from pave.transfer import to_display

        metadata = self.test.metadata(index)
        frame, buffers_seconds = self._render(
            self.buffers, index, metadata["spp"], cheap_depth(self.scene), metadata["seed"]
        )
        begin = time.perf_counter()
        self.generator.draw(frame)
        network_seconds = time.perf_counter() - begin
        for name in self.generator.inputs:
            # Paths are added as they end, and short ones end in another order.
            if not np.allclose(frame[name].numpy(), truth[name].numpy(), 1e-5, 1e-6):
                raise RunError(
                    f"view {metadata['index']}: the cheap pass gives another '{name}' than the data set has: "
                    "the network would draw from what it was not trained on; please report it"
                )
        drawn = frame["drawn"].torch().clone()
        in_torch = self.in_torch.draw(truth)
        write_png(drawn.numpy(), self.figures / f"view-{metadata['index']:04d}-drawn.png")
        write_png(truth["color"].numpy(), self.figures / f"view-{metadata['index']:04d}-path.png")
        return {
            "buffers_seconds": buffers_seconds,
            "network_seconds": network_seconds,
            "path_traced_seconds": metadata["seconds_spent"],
            "torch_difference": float((to_display(drawn) - to_display(in_torch)).abs().max()),
            "psnr": float(psnr(drawn, truth["color"])),
        }

    def _fast(self, index: int, truth: torch.Tensor) -> dict[str, float]:
        from pave.metrics import psnr

        metadata = self.test.metadata(index)
        # Other random numbers than the truth's: its own first samples would be no independent image.
        seed = metadata["seed"] ^ 1
        frame, fast_seconds = self._render(
            self.buffers, index, DRAWING_SPP, cheap_depth(self.scene), seed
        )
        begin = time.perf_counter()
        self.generator.draw(frame)
        fast_seconds += time.perf_counter() - begin
        fast_psnr = float(psnr(frame["drawn"].torch(), truth))
        del frame
        sample_seconds = metadata["seconds_spent"] / metadata["spp"]
        equal_spp = max(1, round(fast_seconds / sample_seconds))
        traced, equal_seconds = self._render(
            self.image, index, equal_spp, metadata["max_depth"], seed
        )
        return {
            "fast_seconds": fast_seconds,
            "fast_psnr": fast_psnr,
            "equal_spp": equal_spp,
            "equal_seconds": equal_seconds,
            "equal_psnr": float(psnr(traced["color"].torch(), truth)),
        }
