"""OpenCL devices: selection, profile, and the same device as pyopencl sees it.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING, Any

from pave import _pave
from pave.errors import DeviceError, UsageError

if TYPE_CHECKING:
    import pyopencl


@dataclasses.dataclass(frozen=True)
class DeviceProfile:
    """What OpenCL says of one device."""

    id: str  # "platform:device", as Device() takes it
    platform: str
    name: str
    vendor: str
    driver: str
    opencl_version: str
    is_cpu: bool
    is_gpu: bool
    host_unified_memory: bool  # host and device share memory
    compute_units: int
    native_float_width: int
    lane_width: int  # lanes that kernels are built with: 16 or 8 on CPUs, 1 on GPUs
    max_work_group_size: int
    global_byte_size: int
    cache_byte_size: int
    max_alloc_byte_size: int

    def to_dict(self) -> dict[str, Any]:
        """Every field by name; goes into JSON as it is."""
        return dataclasses.asdict(self)


def _profile(raw: _pave.DeviceProfile) -> DeviceProfile:
    names = [field.name for field in dataclasses.fields(DeviceProfile)]
    return DeviceProfile(**{name: getattr(raw, name) for name in names})


def devices() -> list[DeviceProfile]:
    """Profiles of the devices of every OpenCL platform that loads.

    Raises DeviceError, with the package to install, if there is no platform.
    """
    return [_profile(raw) for raw in _pave.Device.list_all()]


class Device:
    """One OpenCL device with its context and in-order queue. Any thread; not for use in a forked
    child.

    `spec`: "" (PAVE_DEVICE, else the first GPU, else the first CPU), "cpu", "gpu", "P:D" as
    `devices()` numbers them, or a part of the platform's or device's name in any case, e.g. "pocl".
    Raises DeviceError that lists what there is.
    """

    def __init__(self, spec: str = "") -> None:
        self._set(_pave.Device.select(spec))

    def _set(self, device: _pave.Device) -> None:
        self._device = device
        self._pid = os.getpid()
        self.profile: DeviceProfile = _profile(device.profile)

    @classmethod
    def from_pyopencl(
        cls, context: pyopencl.Context, queue: pyopencl.CommandQueue | None = None
    ) -> Device:
        """A device over a context, and a queue, made by pyopencl: both sides work on the same
        OpenCL objects.

        PAVE retains context, device and queue; the pyopencl objects may be dropped. Without `queue`
        PAVE makes one on the context's only device. Raises UsageError if the context has several
        devices and no queue says which, DeviceError if queue and context do not belong together or
        the queue is out of order.
        """
        found = context.devices
        if queue is None and len(found) != 1:
            raise UsageError(
                f"the context has {len(found)} devices: hand in a queue of the one to use"
            )
        chosen = found[0] if queue is None else queue.device
        device = cls.__new__(cls)
        device._set(
            _pave.Device.from_handles(
                context.int_ptr, chosen.int_ptr, 0 if queue is None else queue.int_ptr
            )
        )
        return device

    def pyopencl(self) -> tuple[pyopencl.Context, pyopencl.CommandQueue]:
        """This device's context and queue as pyopencl objects, each with a reference of its own (no
        new queue is made).

        What goes into this queue runs in order with PAVE's own work. Raises ImportError without
        pyopencl.
        """
        import pyopencl as cl

        self.check_process()
        context = cl.Context.from_int_ptr(self._device.context_handle, retain=True)
        queue = cl.CommandQueue.from_int_ptr(self._device.queue_handle, retain=True)
        return context, queue

    @property
    def slot_access(self) -> str:
        """How host and kernels meet in a slot, as a probe of this device found it.

        "shared": one address, nothing is ever moved (CPU devices). "mapped": one memory, made
        visible by map and unmap. "twin": the slot is pinned host memory beside a device buffer,
        filled by an asynchronous read.
        """
        return self._device.slot_access

    def check_process(self) -> None:
        """Raises DeviceError in a forked child, where an OpenCL driver's threads are gone and any
        call may hang.
        """
        if os.getpid() != self._pid:
            raise DeviceError(
                f"this device was opened by process {self._pid}; OpenCL does not survive fork(): "
                "start workers with the 'spawn' method, or use the device in the parent only"
            )

    def __repr__(self) -> str:
        return f"<pave.Device {self.profile.id} '{self.profile.name}' ({self.profile.platform})>"


def raw_device(device: Device) -> _pave.Device:
    """The library's handle of `device`.

    Raises UsageError for anything that is no device, DeviceError in a forked child.
    """
    if not isinstance(device, Device):
        raise UsageError(f"a pave.Device is needed, not {type(device).__name__}")
    device.check_process()
    return device._device


def raw_device_or_host(device: Device | None) -> _pave.Device | None:
    """The same where None stands for plain host memory."""
    return None if device is None else raw_device(device)


def kernel_cache() -> tuple[str, str]:
    """(folder, note): where compiled kernels are kept, or "" and why nothing is kept (docs/kernel-cache.md)."""
    return _pave.Device.kernel_cache()


def kernel_hash() -> str:
    """XXH3-128 hex of all kernel sources that PAVE was built with."""
    return _pave.Device.kernel_hash()
