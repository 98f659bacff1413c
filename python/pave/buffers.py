"""One slot seen as numpy, torch and pyopencl at once: the same bytes, no copy.

SPDX-License-Identifier: BSD-3-Clause

Ownership: every array, tensor, DLPack capsule and pyopencl buffer made here holds its frame, and so
the slot. The ring hands the slot out again only when the last of them is gone, also when the frame
was published, the stage was closed or the Python frame was released long before.

Writing: views are writable and stay so. One producer writes between acquire() and publish();
afterwards everybody reads. Views are not made read-only by publish(): torch has no read-only
tensors and arrays given out before could not be changed, so a flag would promise a safety that is
not there.
"""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from typing import TYPE_CHECKING, Any

from pave import _pave
from pave.checks import whole
from pave.device import Device, raw_device_or_host
from pave.errors import UsageError
from pave.scene import View

if TYPE_CHECKING:
    import numpy as np
    import pyopencl
    import torch

_METADATA = {
    "index": int,
    "world_from_camera": list,
    "fov_x_degrees": float,
    "spp": int,
    "max_depth": int,
    "rr_depth": int,
    "seed": int,
    "scene": str,
    "scene_hash": str,
    "device": str,
    "driver": str,
    "kernel_hash": str,
    "program_version": str,
    "program_commit": str,
    "weights_version": str,
    "seconds_spent": float,
}
_CHANNEL_ALIGNMENT = 4096  # bytes; kChannelAlignment of staging/include/pave/frame.h


def copies() -> int:
    """Copies of a channel's pixels between a slot and other memory that PAVE made in this process.

    Counted, one for each channel: `numpy(copy=True)` and the other explicit copies of this module;
    `DataLoader.get(NAME)`, which stacks frames; rendering or drawing into a frame that is not in
    the device's memory; every transfer of a slot on devices that have memory of their own
    (`Device.slot_access == "twin"`). Not counted, because no copy: views. Not counted, because they
    make pixels: rendering into the device's own slots, decoding a file. Not counted, because not
    PAVE's: what a caller does with a view. On a CPU device it stays 0.
    """
    return _pave.copies()


def count_copy(channels: int = 1) -> None:
    """Adds to `copies()`: for code that copies `channels` channels on PAVE's behalf."""
    _pave.count_copy(channels)


class Metadata(MutableMapping[str, Any]):
    """What is known of a frame beside its pixels, as a dict of JSON values; writes go to the frame.

    Keys: index, world_from_camera (16 numbers, row-major), fov_x_degrees, spp, max_depth, rr_depth,
    seed, scene, scene_hash, device, driver, kernel_hash, program_version, program_commit,
    weights_version, seconds_spent. The set of keys is fixed: an unknown one is a UsageError when
    written, a KeyError when read.
    """

    __slots__ = ("_metadata",)

    def __init__(self, metadata: _pave.FrameMetadata) -> None:
        self._metadata = metadata

    def __getitem__(self, key: str) -> Any:
        if key not in _METADATA:
            raise KeyError(key)
        if key == "world_from_camera":
            return list(self._metadata.view.world_from_camera)
        if key == "fov_x_degrees":
            return self._metadata.view.fov_x_degrees
        return getattr(self._metadata, key)

    def __setitem__(self, key: str, value: Any) -> None:
        if key not in _METADATA:
            raise UsageError(f"unknown metadata key '{key}'; there are {', '.join(_METADATA)}")
        view = self._metadata.view
        try:
            if key == "world_from_camera":
                self._metadata.view = _pave.View([float(x) for x in value], view.fov_x_degrees)
            elif key == "fov_x_degrees":
                self._metadata.view = _pave.View(view.world_from_camera, float(value))
            else:
                setattr(self._metadata, key, _METADATA[key](value))
        except (TypeError, ValueError) as error:
            raise UsageError(f"metadata '{key}' cannot be {value!r}") from error

    def __delitem__(self, key: str) -> None:
        raise UsageError(f"metadata '{key}' cannot be deleted: the set of keys is fixed")

    def __iter__(self) -> Iterator[str]:
        return iter(_METADATA)

    def __len__(self) -> int:
        return len(_METADATA)

    def __repr__(self) -> str:
        return f"Metadata({dict(self)!r})"


class Channel:
    """The planes of one channel of a frame: float32, (planes, height, width), linear, in the slot's
    own memory.

    Made by `frame["name"]`; holds the frame. Also an array for numpy.asarray() and a DLPack
    producer on the CPU.
    """

    __slots__ = ("_byte_offset", "_device", "_frame", "name", "shape")

    def __init__(
        self,
        frame: _pave.Frame,
        device: Device | None,
        name: str,
        byte_offset: int,
        shape: tuple[int, int, int],
    ) -> None:
        self._frame = frame
        self._device = device
        self._byte_offset = byte_offset
        self.name: str = name
        self.shape: tuple[int, int, int] = shape

    @property
    def address(self) -> int:
        """Address of the first pixel; the same for every view of this channel."""
        return self._frame.address + self._byte_offset

    @property
    def byte_size(self) -> int:
        """Bytes of all planes, without the padding behind them."""
        planes, height, width = self.shape
        return 4 * planes * height * width

    def numpy(self, copy: bool = False) -> np.ndarray:
        """(planes, height, width) float32 over the slot's bytes, writable; holds the slot while it
        or a view lives.

        With `copy` an array of its own memory, and `copies()` rises by one.
        """
        view = self._frame.planes(self._byte_offset, self.shape[0])
        if not copy:
            return view
        _pave.count_copy(1)
        return view.copy()

    def torch(self) -> torch.Tensor:
        """(planes, height, width) float32 CPU tensor over the slot's bytes; holds the slot while it
        or a view lives.
        """
        import torch

        return torch.from_numpy(self.numpy())

    def cl_buffer(self, device: Device | None = None) -> pyopencl.Buffer:
        """The channel as a pyopencl.Buffer: a sub-buffer, from the channel's first byte to its
        last, of the slot's cl_mem.

        It belongs to the context of `device.pyopencl()`, where `device` defaults to the one that
        the stage was made with. On a CPU device kernels that take it work on the very bytes that
        numpy() and torch() show; wait for the queue (`queue.finish()`) before looking. On devices
        with `slot_access` other than "shared" call `frame.to_device()` after writing on the host
        and `frame.to_host()` after kernels wrote. The Buffer object holds the slot: keep it until
        the kernels that use it are done. Raises UsageError if the frame's memory is not of that
        device.
        """
        import pyopencl as cl

        owner = device or self._device
        raw = raw_device_or_host(owner)
        handle = 0 if raw is None else raw.slot_buffer(self._frame)
        if raw is None or handle == 0:
            raise UsageError(
                f"channel '{self.name}' is not in the memory of an OpenCL device: make its stage with "
                "pave.Stage(device, ...), or name the device of that stage"
            )
        slot = cl.Buffer.from_int_ptr(handle, retain=True)
        buffer = slot.get_sub_region(self._byte_offset, self.byte_size)
        # pyopencl's objects take attributes; this one holds the slot as long as the object lives.
        buffer.pave_frame = self._frame
        return buffer

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        view = self.numpy()
        converted = view.astype(dtype or view.dtype, copy=bool(copy))
        if converted is view:
            return view
        if copy is False:
            raise ValueError(f"channel '{self.name}' is float32: another type is a copy")
        _pave.count_copy(1)
        return converted

    def __dlpack__(self, **options: Any) -> Any:
        """A DLPack capsule (kDLCPU) that holds the slot. `copy=True` copies, and `copies()` rises
        by one.
        """
        if options.get("copy"):
            _pave.count_copy(1)
        return self.numpy().__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.numpy().__dlpack_device__()

    def __repr__(self) -> str:
        planes, height, width = self.shape
        return f"<pave.Channel '{self.name}' float32 ({planes}, {height}, {width})>"


class Frame:
    """The channels of one view and its metadata, in one slot. A handle: the slot is not reused
    while it lives.

    `frame["color"]` is a Channel; `"color" in frame`, `list(frame)` and `len(frame)` are about
    channel names. In a loop over few slots let go of the last frame before acquiring the next:
    `release()`, or `del`.
    """

    __slots__ = ("_device", "_handle", "_layout", "height", "width")

    def __init__(self, frame: _pave.Frame, device: Device | None = None) -> None:
        schema = frame.schema
        self._handle: _pave.Frame | None = frame
        self._device = device
        self._layout = {name: (planes, offset) for name, planes, offset in schema.layout()}
        self.width: int = schema.width
        self.height: int = schema.height

    @property
    def _frame(self) -> _pave.Frame:
        if self._handle is None:
            raise UsageError("this frame was released")
        return self._handle

    @property
    def channels(self) -> tuple[str, ...]:
        """Channel names in the order of memory."""
        return tuple(self._layout)

    @property
    def device(self) -> Device | None:
        """The device whose memory the slot is in; None for host memory."""
        return self._device

    @property
    def metadata(self) -> Metadata:
        """What is known of the frame; writable until the frame is published."""
        return Metadata(self._frame.metadata)

    @property
    def view(self) -> View:
        """The camera that the frame was made with; a copy, which neither changes nor holds the slot."""
        return View.from_raw(self._frame.metadata.view)

    @property
    def slot_index(self) -> int:
        """Which slot of its ring this is."""
        return self._frame.slot_index

    def __getitem__(self, name: str) -> Channel:
        if name not in self._layout:
            known = ", ".join(self._layout)
            raise UsageError(f"frame has no channel '{name}'; it has {known}")
        planes, byte_offset = self._layout[name]
        shape = (planes, self.height, self.width)
        return Channel(self._frame, self._device, name, byte_offset, shape)

    def __contains__(self, name: object) -> bool:
        return name in self._layout

    def __iter__(self) -> Iterator[str]:
        return iter(self._layout)

    def __len__(self) -> int:
        return len(self._layout)

    def numpy(self) -> np.ndarray:
        """All channels as one (C, H, W) float32 array over the slot's bytes, channels in the order
        of `channels`.

        Raises UsageError if the planes are not contiguous, see torch().
        """
        expected = 0
        total = 0
        for name, (planes, byte_offset) in self._layout.items():
            if byte_offset != expected:
                raise UsageError(
                    f"a frame of {self.width}x{self.height} is not one tensor: '{name}' starts on the next "
                    f"multiple of {_CHANNEL_ALIGNMENT} bytes and leaves a gap; use frame['NAME'], or a size "
                    f"with width * height a multiple of {_CHANNEL_ALIGNMENT // 4}"
                )
            expected += 4 * planes * self.height * self.width
            total += planes
        return self._frame.planes(0, total)

    def torch(self) -> torch.Tensor:
        """All channels as one (C, H, W) float32 tensor over the slot's bytes, channels in the order
        of `channels`.

        Every channel starts on a multiple of 4096 bytes, so this needs width * height to be a
        multiple of 1024 (any power of two from 32x32 on); else it raises UsageError.
        """
        import torch

        return torch.from_numpy(self.numpy())

    def to_device(self) -> None:
        """Makes what the host wrote visible to kernels enqueued from now on. Nothing to do on CPU
        devices.
        """
        self._transfer(to_host=False)

    def to_host(self) -> None:
        """Makes what kernels wrote visible to the host; blocks until the queue's work so far is
        done.
        """
        self._transfer(to_host=True)

    def _transfer(self, to_host: bool) -> None:
        raw = raw_device_or_host(self._device)
        if raw is None:
            return
        if raw.slot_access == "twin":
            _pave.count_copy(len(self))
        if to_host:
            raw.to_host(self._frame)
        else:
            raw.to_device(self._frame)

    def release(self) -> None:
        """Lets go of the slot now. Arrays, tensors and buffers made before keep holding it.
        Idempotent.
        """
        self._handle = None

    def __repr__(self) -> str:
        state = "released" if self._handle is None else f"slot {self._handle.slot_index}"
        names = ", ".join(self._layout)
        return f"<pave.Frame {self.width}x{self.height} [{names}] {state}>"


def make_frame(
    device: Device | None,
    width: int,
    height: int,
    channels: list[str | tuple[str, int]] | tuple[str | tuple[str, int], ...],
) -> Frame:
    """A zero-filled frame of its own memory, outside any ring; in the memory of `device`, or of the
    host with None.

    Raises UsageError for a bad size or channel, DeviceError if the device has not the memory.
    """
    schema = _pave.make_schema(
        whole("width", width), whole("height", height), channel_planes(channels)
    )
    raw = raw_device_or_host(device)
    return Frame(_pave.make_frame(schema) if raw is None else raw.make_frame(schema), device)


def channel_planes(channels: Any) -> list[tuple[str, int]]:
    """Channels as (name, planes); a bare name is one that PAVE knows. Raises UsageError that lists
    those.
    """
    if isinstance(channels, str):
        channels = [channels]
    pairs: list[tuple[str, int]] = []
    for channel in channels:
        if not isinstance(channel, str):
            name, planes = channel
            pairs.append((str(name), whole(f"planes of '{name}'", planes)))
            continue
        planes = _pave.known_channel_planes(channel)
        if planes == 0:
            raise UsageError(
                f"unknown channel '{channel}'; known are {', '.join(KNOWN_CHANNELS)}; "
                "one of your own is ('name', planes)"
            )
        pairs.append((channel, planes))
    return pairs


KNOWN_CHANNELS = (
    "color",
    "albedo",
    "direct",
    "normal",
    "depth",
    "distance",
    "variance",
    "position",
    "object",
    "drawn",
)
