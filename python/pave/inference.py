"""Draws with a trained generator inside the renderer: cheap buffers in, image out, one OpenCL device.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pave

# A camera ray and one scattering event: all that `direct` and the geometry buffers need.
CHEAP_DEPTH = 2
DRAWING_SPP = 32  # samples of the cheap buffers: more cost time that path tracing could use too
SPECULAR_DEPTH = 8  # mirrors and glass are followed to the first other surface


def cheap_depth(scene: pave.Scene) -> int:
    """Longest path, in edges, that the cheap buffers of `scene` need."""
    return SPECULAR_DEPTH if scene.has_specular else CHEAP_DEPTH


def draw_view(
    run: Path,
    scene: pave.Scene,
    *,
    device: str = "",
    view: pave.View | None = None,
    width: int,
    height: int,
    spp: int,
    seed: int = 0,
    compare: bool = False,
) -> tuple[pave.Frame, dict[str, Any]]:
    """Renders the buffers that the generator of `run` asks for and lets it write the channel `drawn`.

    With `compare` the view is path traced too, at the scene's own samples and depth, into `color`; the record then has
    psnr and ssim of `drawn` against it (both sRGB, clipped to [0, 1]). Raises UsageError if the scene's buffers are not
    what the generator was trained on.
    """
    import pave

    if compare:
        from pave.metrics import check_size, psnr, ssim

        check_size(width, height)
    target = pave.Device(device)
    generator = pave.Generator(target, str(run))
    channels = [*generator.inputs, "drawn"]
    if compare:
        channels.append("color")
    stage = pave.Stage(target, "mem:", width=width, height=height, channels=channels, slots=2)
    frame = stage.acquire()
    renderer = pave.Renderer(target, scene)
    view = view or scene.view
    begin = time.perf_counter()
    renderer.render(view, frame, spp=spp, max_depth=cheap_depth(scene), seed=seed)
    rendered = time.perf_counter()
    generator.draw(frame)
    drawn = time.perf_counter()
    record: dict[str, Any] = {
        "size": [width, height],
        "spp": spp,
        "weights_version": generator.weights_version,
        "seconds": {"buffers": rendered - begin, "network": drawn - rendered},
    }
    if compare:
        reference = stage.acquire()
        renderer.render(
            view,
            reference,
            spp=scene.spp,
            max_depth=scene.max_depth,
            rr_depth=scene.rr_depth,
            seed=seed + 1,
        )
        frame["color"].numpy()[:] = reference["color"].numpy()
        record["seconds"]["path_traced"] = reference.metadata["seconds_spent"]
        ours, truth = frame["drawn"].torch(), frame["color"].torch()
        record["psnr"], record["ssim"] = float(psnr(ours, truth)), float(ssim(ours, truth))
    return frame, record
