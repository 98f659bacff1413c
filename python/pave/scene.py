"""Scenes and views, the path tracer, and the trained network that draws in its place.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from pave import _pave
from pave.checks import INT64_MAX, UINT64_MAX, whole
from pave.device import Device, raw_device
from pave.errors import UsageError

if TYPE_CHECKING:
    import numpy as np

    from pave.buffers import Frame


class View:
    """A pinhole camera as Mitsuba 3 has it: right-handed, +X left, +Y up, +Z along the view.
    Immutable.

    `matrix` is camera to world, 4x4 row-major; `fov` the horizontal field of view in degrees, in
    (0, 180). Raises UsageError for other shapes, numbers that are not finite, or a field of view
    outside.
    """

    __slots__ = ("_view",)

    def __init__(self, matrix: Any, fov: float = 40.0) -> None:
        import numpy as np

        try:
            array = np.asarray(matrix, dtype=np.float32)
        except (TypeError, ValueError) as error:
            raise UsageError("a view's matrix must be 4x4 numbers") from error
        if array.shape != (4, 4) or not np.isfinite(array).all():
            raise UsageError(f"a view's matrix must be 4x4 finite numbers, not {array.shape}")
        self._view = _pave.View(array.ravel().tolist(), _checked_fov(fov))

    @classmethod
    def from_raw(cls, raw: _pave.View) -> View:
        """The same view out of the library's own struct."""
        view = cls.__new__(cls)
        view._view = raw
        return view

    @property
    def matrix(self) -> np.ndarray:
        """Camera to world, (4, 4) float32, a copy."""
        import numpy as np

        return np.array(self._view.world_from_camera, dtype=np.float32).reshape(4, 4)

    @property
    def fov(self) -> float:
        """Horizontal field of view in degrees."""
        return self._view.fov_x_degrees

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, View):
            return NotImplemented
        return self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __reduce__(self) -> tuple[Any, ...]:
        return View, (self.matrix, self.fov)

    def _key(self) -> tuple[float, ...]:
        return (*self._view.world_from_camera, self._view.fov_x_degrees)

    def __repr__(self) -> str:
        eye = ", ".join(f"{x:.4g}" for x in self._view.world_from_camera[3:12:4])
        return f"<pave.View from ({eye}), fov {self.fov:.4g}>"


def _checked_fov(fov: float) -> float:
    value = float(fov)
    if not 0.0 < value < 180.0:
        raise UsageError(f"a field of view of {value} degrees is outside (0, 180)")
    return value


def _point(values: Sequence[float], name: str) -> list[float]:
    try:
        point = [float(x) for x in values]
    except (TypeError, ValueError) as error:
        raise UsageError(f"look_at: {name} must be three numbers") from error
    if len(point) != 3 or not all(map(math.isfinite, point)):
        raise UsageError(f"look_at: {name} must be three finite numbers, not {values!r}")
    return point


def look_at(
    eye: Sequence[float],
    target: Sequence[float],
    up: Sequence[float] = (0.0, 1.0, 0.0),
    fov: float = 40.0,
) -> View:
    """View from `eye` to `target`, world coordinates in scene units; `fov` is horizontal, in
    degrees.

    Raises UsageError if eye == target or `up` is parallel to the view axis.
    """
    raw = _pave.look_at(
        _point(eye, "eye"), _point(target, "target"), _point(up, "up"), _checked_fov(fov)
    )
    return View.from_raw(raw)


class Scene:
    """A scene as loaded; immutable. Made by load_scene()."""

    def __init__(self, raw: _pave.Scene) -> None:
        self._scene = raw
        self.name: str = raw.name  # file name without folder and extension
        self.hash: str = raw.hash  # XXH3-128 hex over the scene file and its meshes
        self.view: View = View.from_raw(raw.view)  # the file's sensor
        self.width: int = raw.width  # the file's film, in pixels
        self.height: int = raw.height
        self.spp: int = raw.spp  # the file's samples a pixel
        self.max_depth: int = raw.max_depth  # edges of the longest path
        self.rr_depth: int = raw.rr_depth  # Russian roulette from this depth on
        self.warnings: list[str] = list(raw.warnings)  # what ignore_unsupported left out
        self.bounds_min: tuple[float, ...] = tuple(raw.bounds_min)
        self.bounds_max: tuple[float, ...] = tuple(raw.bounds_max)
        self.shape_count: int = raw.shape_count
        self.has_specular: bool = raw.has_specular  # a mirror or glass is among the materials

    def __repr__(self) -> str:
        return f"<pave.Scene '{self.name}', {self.shape_count} shapes>"


def load_scene(
    name_or_path: str | os.PathLike[str],
    ignore_unsupported: bool = False,
    defines: Mapping[str, Any] | None = None,
) -> Scene:
    """Reads a scene file of the Mitsuba 3 XML subset.

    A bare name ("cornell") is one of PAVE's own scenes (PAVE_SCENE_DIR overrides where), anything
    with a slash or ".xml" a path. `defines` sets the file's <default> names, as Mitsuba's -D. With
    `ignore_unsupported` what PAVE does not know becomes `scene.warnings`; else InputError
    "file:line: node: reason".
    """
    texts = {str(key): str(value) for key, value in (defines or {}).items()}
    return Scene(_pave.load_scene(os.fspath(name_or_path), ignore_unsupported, texts))


def hemisphere_views(scene: Scene, n: int, seed: int = 0) -> list[View]:
    """`n` views on the hemisphere around the scene's centre, on its camera's side, all looking at
    the centre.

    Deterministic: view i depends on `seed` and i alone. Raises UsageError for n < 0.
    """
    count = whole("number of views", n, 0)
    views = _pave.hemisphere_views(scene._scene, count, whole("seed", seed, 0, UINT64_MAX))
    return [View.from_raw(raw) for raw in views]


class _OneAtATime:
    """Lets threads take turns; a call from inside its own callback is a UsageError instead of a
    deadlock.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._lock = threading.Lock()
        self._owner = 0

    @contextmanager
    def turn(self) -> Iterator[None]:
        if self._owner == threading.get_ident():
            raise UsageError(f"{self._what} cannot be called from its own progress callback")
        with self._lock:
            self._owner = threading.get_ident()
            try:
                yield
            finally:
                self._owner = 0


def _count_transfers(raw: _pave.Device, frame: Frame, channels: int) -> None:
    """`copies()` for work that does not happen in the slot itself."""
    if raw.slot_access == "twin" or raw.slot_buffer(frame._frame) == 0:
        _pave.count_copy(channels)


class Renderer:
    """A scene on a device, with the kernels specialised for it. Threads take turns; renderers are
    independent.

    Groups are copied to the places of their instances, the smallest first, as long as the copies
    have no more than `copied_triangles` in all, and always where they are placed once: that is
    faster and takes more memory. -1 copies none.
    """

    def __init__(self, device: Device, scene: Scene, copied_triangles: int = 1 << 18) -> None:
        self.device: Device = device
        self.scene: Scene = scene
        self._renderer = _pave.Renderer(
            raw_device(device), scene._scene, whole("copied_triangles", copied_triangles, -1)
        )
        self._turns = _OneAtATime("render")

    def render(
        self,
        view: View | None,
        frame: Frame,
        *,
        spp: int | None = None,
        max_depth: int | None = None,
        rr_depth: int | None = None,
        sampler: str = "sobol",
        seed: int = 0,
        frame_index: int | None = None,
        progress: Callable[[float], bool | None] | None = None,
        tile_rows: int = 0,
        work_group_size: int = 0,
        lane_width: int = 0,
    ) -> None:
        """Renders every channel of `frame` that the path tracer knows, in one pass, and its
        metadata. Blocks.

        `view` None is the scene file's; so are `spp` (samples a pixel), `max_depth` (edges of the
        longest path) and `rr_depth` (Russian roulette from there on). `sampler`
        is "sobol" (stratified at the first two vertices of a path, so less noise; channel `variance`
        is then an upper bound) or "independent". `seed` and `frame_index` (by
        default the number that the frame's stage gave it) key the random numbers: same values, same
        bits. `tile_rows`, `work_group_size` and `lane_width` change only the schedule; 0 chooses.

        `progress` is called between launches with the fraction done; returning False cancels with
        RunError, raising ends the render with that exception; Ctrl-C raises KeyboardInterrupt. The
        interpreter lock is free meanwhile. Other errors: UsageError for options out of range,
        DeviceError from OpenCL.
        """
        raw = raw_device(self.device)
        scene = self.scene
        index = frame._frame.metadata.index if frame_index is None else frame_index
        with self._turns.turn():
            self._renderer.render(
                (scene.view if view is None else view)._view,
                frame._frame,
                spp=whole("spp", scene.spp if spp is None else spp),
                max_depth=whole("max_depth", scene.max_depth if max_depth is None else max_depth),
                rr_depth=whole("rr_depth", scene.rr_depth if rr_depth is None else rr_depth),
                sampler=sampler,
                seed=whole("seed", seed, 0, UINT64_MAX),
                frame_index=whole("frame_index", index, 0, INT64_MAX),
                tile_rows=whole("tile_rows", tile_rows),
                work_group_size=whole("work_group_size", work_group_size),
                lane_width=whole("lane_width", lane_width),
                progress=progress,
            )
        _count_transfers(raw, frame, len(frame))

    @property
    def dropped_samples(self) -> int:
        """Samples of all renders so far that met radiance that is not finite, which was left out; 0 is
        normal."""
        return self._renderer.dropped_samples

    @property
    def dropped_triangles(self) -> int:
        """Triangles of the scene without an area or with absurd coordinates, which were left out."""
        return self._renderer.dropped_triangles

    def __repr__(self) -> str:
        return f"<pave.Renderer of {self.scene!r} on {self.device!r}>"


class Generator:
    """A network exported by `pave train`, on an OpenCL device, with no ML framework. Threads take
    turns.

    `run` is the folder with generator.json and generator.safetensors. Raises InputError naming file
    and reason.
    """

    def __init__(self, device: Device, run: str | os.PathLike[str]) -> None:
        self.device: Device = device
        self._generator = _pave.Generator(raw_device(device), os.fspath(run))
        self._turns = _OneAtATime("draw")

    @property
    def inputs(self) -> list[str]:
        """Input channels by name, in the network's order."""
        return list(self._generator.inputs)

    @property
    def weights_version(self) -> str:
        """XXH3-128 hex of generator.safetensors."""
        return self._generator.weights_version

    def draw(self, frame: Frame) -> None:
        """Reads the input channels of `frame` and writes linear radiance to "drawn", or to "color"
        if it has no "drawn".

        Blocks; the interpreter lock is free. Raises UsageError "missing input: NAME" if the frame
        lacks an input.
        """
        raw = raw_device(self.device)
        with self._turns.turn():
            self._generator.draw(frame._frame)
        _count_transfers(raw, frame, len(self.inputs) + 1)

    def run(
        self, planes: Any, layers: bool = False
    ) -> np.ndarray | tuple[np.ndarray, dict[str, np.ndarray]]:
        """Runs the graph on encoded input planes (C, H, W) and returns the encoded output planes
        (C, H, W).

        With `layers` also a dict of every node's output by node name, each flat. For parity tests.
        """
        import numpy as np

        array = np.ascontiguousarray(planes, dtype=np.float32)
        if array.ndim != 3:
            raise UsageError(f"the input must be (C, H, W), not {array.shape}")
        raw_device(self.device)
        with self._turns.turn():
            return self._generator.run(array, layers)

    def planned_byte_size(self, width: int, height: int) -> tuple[int, int]:
        """Bytes of activations for this size: with the plan's reuse, and without."""
        return self._generator.planned_byte_size(whole("width", width), whole("height", height))
