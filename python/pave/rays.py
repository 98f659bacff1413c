"""Ray queries against a scene, for programs that trace rays of their own.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from pave import _pave
from pave.checks import whole
from pave.device import Device, raw_device
from pave.errors import UsageError

if TYPE_CHECKING:
    import pyopencl

    from pave.scene import Scene

# Records as the kernels read and write them; pave::Ray and pave::Hit in pave/rays.h.
RAY = np.dtype([("origin", "<f4", 3), ("t_max", "<f4"), ("direction", "<f4", 3), ("spare", "<f4")])
HIT = np.dtype(
    [
        ("t", "<f4"),
        ("shape", "<i4"),
        ("part", "<i4"),
        ("primitive", "<i4"),
        ("b1", "<f4"),
        ("b2", "<f4"),
    ]
)


def make_rays(origins: Any, directions: Any, t_max: Any = np.inf) -> np.ndarray:
    """Ray records (dtype `pave.rays.RAY`) of arrays that broadcast to (n, 3), (n, 3) and (n,).

    Fill such an array in place instead where copies matter. Raises UsageError for other shapes.
    """
    try:
        o = np.atleast_2d(np.asarray(origins, dtype=np.float32))
        d = np.atleast_2d(np.asarray(directions, dtype=np.float32))
        o, d = np.broadcast_arrays(o, d)
        if o.ndim != 2 or o.shape[1] != 3:
            raise ValueError(f"origins and directions are (n, 3), not {o.shape}")
        rays = np.zeros(len(o), RAY)
        rays["origin"], rays["direction"] = o, d
        rays["t_max"] = np.asarray(t_max, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise UsageError(f"rays: {error}") from error
    return rays


class RayTracer:
    """A scene on a device, for ray queries. Threads take turns; ray tracers are independent.

    `lane_width` (1, 4, 8, 16) forces kernels of that width; 0 chooses. Raises InputError for a
    scene that cannot be traced, UsageError for options out of range.
    """

    def __init__(self, device: Device, scene: Scene, lane_width: int = 0) -> None:
        self.device: Device = device
        self._tracer = _pave.RayTracer(
            raw_device(device), scene._scene, whole("lane_width", lane_width)
        )
        self._lock = threading.Lock()

    def trace_closest(self, rays: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """What each ray meets first, as records (dtype `pave.rays.HIT`): t (inf: nothing), shape
        (-1: nothing), part (of an instance: which of its group's shapes; else -1), primitive, and
        the weights b1 and b2 of a triangle's second and third vertex.

        `rays` has dtype `pave.rays.RAY`, or is float32 (n, 8) of the same bytes; `out` takes the
        hits in place. Blocks; the interpreter lock is free. On CPU devices the kernels work in the
        arrays themselves. Raises UsageError for arrays of another kind or length.
        """
        records = _records(rays, RAY, "rays")
        hits = np.empty(len(records), HIT) if out is None else _records(out, HIT, "out")
        raw_device(self.device)
        _check_room(len(records), hits)
        with self._lock:
            self._tracer.trace_closest(
                records.view(np.float32).reshape(-1, 8), hits.view(np.float32).reshape(-1, 6)
            )
        return hits

    def trace_any(self, rays: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Whether each ray meets anything before its t_max, as bool. As trace_closest otherwise."""
        records = _records(rays, RAY, "rays")
        flags = np.empty(len(records), np.bool_) if out is None else out
        if flags.dtype != np.bool_ or flags.ndim != 1 or not flags.flags.c_contiguous:
            raise UsageError("out: a contiguous array of bool is needed")
        raw_device(self.device)
        _check_room(len(records), flags)
        with self._lock:
            self._tracer.trace_any(records.view(np.float32).reshape(-1, 8), flags.view(np.uint8))
        return flags

    def enqueue_closest(self, rays: pyopencl.Buffer, hits: pyopencl.Buffer, count: int) -> None:
        """The same over pyopencl buffers of the device's context; returns once enqueued on its
        queue. Raises UsageError for a too small buffer or one of another context.
        """
        self._enqueue(self._tracer.enqueue_closest, rays, hits, count)

    def enqueue_any(self, rays: pyopencl.Buffer, occluded: pyopencl.Buffer, count: int) -> None:
        """trace_any over pyopencl buffers, one byte a ray. As enqueue_closest."""
        self._enqueue(self._tracer.enqueue_any, rays, occluded, count)

    def _enqueue(self, verb: Any, rays: Any, results: Any, count: int) -> None:
        raw_device(self.device)
        with self._lock:
            verb(_handle(rays), _handle(results), whole("count", count, 0, 2**62 // RAY.itemsize))

    @property
    def dropped_triangles(self) -> int:
        """Triangles without an area or with absurd coordinates, which no ray meets."""
        return self._tracer.dropped_triangles

    def __repr__(self) -> str:
        return f"<pave.RayTracer on {self.device!r}>"


def _records(array: Any, dtype: np.dtype, name: str) -> np.ndarray:
    """`array` as contiguous records, its own memory."""
    width = dtype.itemsize // 4
    if isinstance(array, np.ndarray) and array.flags.c_contiguous:
        if array.dtype == dtype and array.ndim == 1:
            return array
        if array.dtype == np.float32 and array.ndim == 2 and array.shape[1] == width:
            return array.reshape(-1).view(dtype)
    raise UsageError(
        f"{name}: a contiguous array of {dtype.names}, or of float32 (n, {width}), is needed"
    )


def _check_room(count: int, out: np.ndarray) -> None:
    if len(out) != count:
        raise UsageError(f"out: room for {len(out)} results of {count} rays")
    if not out.flags.writeable:
        raise UsageError("out: the array is read-only")


def _handle(buffer: Any) -> int:
    try:
        return int(buffer.int_ptr)
    except (AttributeError, TypeError) as error:
        raise UsageError(f"a pyopencl.Buffer is needed, not {type(buffer).__name__}") from error
