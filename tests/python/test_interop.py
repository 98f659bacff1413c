"""The same OpenCL objects on both sides: pyopencl's wheel has an OpenCL loader of its own, PAVE uses the system's.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import textwrap

import numpy as np
import pyopencl as cl
import pytest

import pave


@pytest.fixture(scope="module")
def cl_device():
    profile = pave.Device("cpu").profile
    platform, number = map(int, profile.id.split(":"))
    return cl.get_platforms()[platform].get_devices()[number]


def test_pave_device_as_pyopencl():
    device = pave.Device("cpu")
    context, queue = device.pyopencl()
    assert context.int_ptr == device._device.context_handle
    assert queue.int_ptr == device._device.queue_handle
    assert queue.context == context
    assert context.devices[0].name == device.profile.name
    assert device.pyopencl() == (context, queue)


def test_pyopencl_objects_outlive_the_device():
    context, queue = pave.Device("cpu").pyopencl()
    gc.collect()
    data = np.arange(16, dtype=np.float32)
    buffer = cl.Buffer(context, cl.mem_flags.COPY_HOST_PTR, hostbuf=data)
    out = np.empty_like(data)
    cl.enqueue_copy(queue, out, buffer)
    np.testing.assert_array_equal(out, data)


def test_pyopencl_context_handed_in(cl_device):
    context = cl.Context([cl_device])
    queue = cl.CommandQueue(context)
    device = pave.Device.from_pyopencl(context, queue)
    assert device.pyopencl() == (context, queue)
    frame = pave.make_frame(device, 32, 32, ["color"])
    frame["color"].numpy()[:] = 4
    program = cl.Program(
        context, "__kernel void half_(__global float* p) { p[get_global_id(0)] /= 2; }"
    )
    program.build().half_(queue, (3 * 32 * 32,), None, frame["color"].cl_buffer())
    queue.finish()
    assert float(frame["color"].numpy().max()) == 2


def test_pave_holds_references_of_its_own(cl_device):
    context = cl.Context([cl_device])
    before = context.reference_count
    device = pave.Device.from_pyopencl(context)
    assert context.reference_count > before
    del device
    gc.collect()
    assert context.reference_count == before
    device = pave.Device.from_pyopencl(context)
    del context
    gc.collect()
    frame = pave.make_frame(device, 8, 8, ["depth"])
    assert frame["depth"].cl_buffer().size == 256


def test_objects_that_do_not_belong_together(cl_device):
    first, second = cl.Context([cl_device]), cl.Context([cl_device])
    with pytest.raises(pave.DeviceError, match="another context"):
        pave.Device.from_pyopencl(first, cl.CommandQueue(second))
    properties = cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE
    if cl_device.queue_properties & properties:
        queue = cl.CommandQueue(first, properties=properties)
        with pytest.raises(pave.DeviceError, match="out of order"):
            pave.Device.from_pyopencl(first, queue)
    with pytest.raises(pave.UsageError, match=r"pave\.Device is needed"):
        pave.make_frame(first, 8, 8, ["color"])  # type: ignore[arg-type]


SHARE = """
    {imports}
    def loaders():
        with open("/proc/self/maps") as maps:
            return {{line.split()[-1] for line in maps if "libOpenCL" in line}}
    import numpy as np
    device = pave.Device("cpu")
    context, queue = device.pyopencl()
    frame = pave.make_frame(device, 32, 32, ["color"])
    frame["color"].numpy()[:] = 1.5
    program = cl.Program(context, "__kernel void twice(__global float* p) {{ p[get_global_id(0)] *= 2; }}").build()
    program.twice(queue, (3 * 32 * 32,), None, frame["color"].cl_buffer())
    queue.finish()
    assert (frame["color"].numpy() == 3).all()
    theirs = cl.Context(context.devices)
    mine = pave.Device.from_pyopencl(theirs)
    assert mine.profile == device.profile
    assert pave.copies() == 0
    print(len(loaders()))
"""


@pytest.mark.parametrize(
    "imports", ["import pave; import pyopencl as cl", "import pyopencl as cl; import pave"]
)
def test_two_loaders_share_one_device_in_either_order(imports):
    """Handles of one loader work in the other: both only forward to the driver's own objects."""
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(SHARE.format(imports=imports))],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 0, result.stderr
    bundled = os.path.isdir(os.path.join(os.path.dirname(cl.__file__), ".libs"))
    assert int(result.stdout) == (2 if bundled else 1)
