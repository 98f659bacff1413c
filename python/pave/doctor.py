"""Checks the installation part by part and says how to mend what is missing.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import importlib.metadata
import time
from typing import Any

NO_PLATFORM_FIX = "apt install pocl-opencl-icd"


def _package(name: str, why: str) -> dict[str, Any]:
    try:
        return {"check": name, "ok": True, "detail": importlib.metadata.version(name)}
    except importlib.metadata.PackageNotFoundError:
        return {
            "check": name,
            "ok": False,
            "detail": f"missing ({why})",
            "fix": f"pip install {name}",
        }


def _render_probe(spec: str) -> dict[str, Any]:
    """Renders a tiny Cornell box: shows that kernels build, run and put sane numbers into host memory."""
    import numpy as np

    import pave

    begin = time.perf_counter()
    device = pave.Device(spec)
    scene = pave.load_scene("cornell")
    stage = pave.Stage(device, "mem:", width=16, height=16, channels=["color", "depth"], slots=1)
    frame = stage.acquire()
    pave.Renderer(device, scene).render(scene.view, frame, spp=16, max_depth=4, seed=1)
    color = frame["color"].numpy()
    ok = bool(np.isfinite(color).all() and color.mean() > 0)
    seconds = time.perf_counter() - begin
    detail = f"{device.profile.name}: 16x16 image in {seconds:.2f} s, kernels included"
    return {"check": "render", "ok": ok, "detail": detail, "seconds": seconds}


def run_checks(spec: str = "") -> list[dict[str, Any]]:
    """All checks as records {check, ok, detail, fix?}, in order; never raises for what it checks."""
    from pave import errors

    records: list[dict[str, Any]] = []
    fix = ""
    try:
        import pave

        records.append(
            {"check": "pave", "ok": True, "detail": f"{pave.__version__} ({pave.commit()})"}
        )
        fix = NO_PLATFORM_FIX
        profiles = pave.devices()
        fix = ""  # there is a platform: what fails now is not mended by installing one
        for profile in profiles:
            records.append(
                {
                    "check": f"device {profile.id}",
                    "ok": True,
                    "detail": f"{profile.name} ({profile.platform}, {profile.driver}), "
                    f"{profile.compute_units} units, {profile.lane_width} lanes",
                }
            )
        folder, note = pave.kernel_cache()
        kept = folder or f"none, kernels compile at every start: {note}"
        records.append({"check": "kernel cache", "ok": True, "detail": kept})
        records.append(_render_probe(spec))
    except errors.Error as error:
        records.append({"check": "opencl", "ok": False, "detail": str(error), "fix": fix})
    for name, why in (
        ("torch", "training"),
        ("pyopencl", "sharing buffers with OpenCL programs in Python"),
        ("adios2", "bp: data sets"),
        ("safetensors", "weights"),
        ("matplotlib", "figures"),
    ):
        records.append(_package(name, why))
    return records
