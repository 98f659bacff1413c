"""PAVE: a portable OpenCL path tracer coupled in situ with machine learning, over one piece of
memory.

SPDX-License-Identifier: BSD-3-Clause

    device   = pave.Device("pocl")
    renderer = pave.Renderer(device, pave.load_scene("cornell"))
    stage    = pave.Stage(device, "mem:", width=256, height=256, channels=["color", "depth"])
    frame    = stage.acquire()
    renderer.render(pave.look_at(eye, target), frame, spp=64, seed=7)
    frame["color"].torch()          # the slot's own memory; likewise .numpy() and .cl_buffer()

DataLoader, Dataset and RayTracer are loaded when first used, since they need torch or numpy. Errors
are those of pave.errors.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

try:
    import pave._pave as _pave
except ImportError as error:
    _reason = f"PAVE's compiled module cannot be loaded: {error}; run ./pave, which builds it"
    # `python -m pave` comes here before __main__ has a chance to make this one line.
    if sys.argv[:1] == ["-m"] and any(word.partition(".")[0] == "pave" for word in sys.orig_argv):
        sys.exit(f"pave: error: {' '.join(_reason.split())}")
    raise ImportError(_reason) from error

from pave.buffers import (
    KNOWN_CHANNELS,
    Channel,
    Frame,
    Metadata,
    copies,
    count_copy,
    make_frame,
)
from pave.device import Device, DeviceProfile, devices, kernel_cache, kernel_hash
from pave.errors import (
    ClError,
    DeviceError,
    Error,
    ExitCode,
    InputError,
    InternalError,
    PeerError,
    RunError,
    UsageError,
)
from pave.scene import Generator, Renderer, Scene, View, hemisphere_views, load_scene, look_at
from pave.stage import Source, Stage, Trace, read_exr, write_exr

if TYPE_CHECKING:
    from pave.data import DataLoader, Dataset
    from pave.rays import RayTracer

__version__: str = _pave.program_version()

__all__ = [
    "KNOWN_CHANNELS",
    "Channel",
    "ClError",
    "DataLoader",
    "Dataset",
    "Device",
    "DeviceError",
    "DeviceProfile",
    "Error",
    "ExitCode",
    "Frame",
    "Generator",
    "InputError",
    "InternalError",
    "Metadata",
    "PeerError",
    "RayTracer",
    "Renderer",
    "RunError",
    "Scene",
    "Source",
    "Stage",
    "Trace",
    "UsageError",
    "View",
    "commit",
    "copies",
    "count_copy",
    "devices",
    "hash_bytes",
    "hemisphere_views",
    "kernel_cache",
    "kernel_hash",
    "load_scene",
    "look_at",
    "make_frame",
    "read_exr",
    "write_exr",
]


def commit() -> str:
    """Git commit of the build, "+" behind it if the tree was changed; "unknown" outside git."""
    return _pave.program_commit()


def hash_bytes(data: Any) -> str:
    """XXH3-128 of any contiguous buffer, bytes or numpy array, as 32 hex digits.

    The one hash of PAVE's files (what `xxhsum -H2` prints): it finds damage, it is no defence
    against forgery. The interpreter lock is free meanwhile. Raises UsageError for anything that is
    no buffer or has gaps.
    """
    try:
        return _pave.hash_bytes(data)
    except (BufferError, TypeError, ValueError) as error:
        raise UsageError(f"hash_bytes takes a contiguous buffer: {error}") from error


def __getattr__(name: str) -> Any:
    if name in ("DataLoader", "Dataset"):
        from pave import data

        return getattr(data, name)
    if name == "RayTracer":
        from pave.rays import RayTracer

        return RayTracer
    raise AttributeError(f"module 'pave' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), "DataLoader", "Dataset", "RayTracer"])
