"""One slot as numpy, torch and pyopencl: the same bytes in both directions, and a slot that waits for its readers.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pyopencl as cl
import pytest
import torch

import pave

SIZE = 32
CHANNELS = ("color", "albedo", "depth")
KERNELS = """
__kernel void negate(__global const float* from, __global float* to) { to[get_global_id(0)] = -from[get_global_id(0)]; }
__kernel void scale(__global float* pixels, float factor) { pixels[get_global_id(0)] *= factor; }
__kernel void where(__global float* pixels, __global ulong* address) { *address = (ulong)pixels; }
"""


@pytest.fixture(scope="module")
def device():
    return pave.Device("cpu")


@pytest.fixture(scope="module")
def kernels(device):
    context, queue = device.pyopencl()
    program = cl.Program(context, KERNELS).build()
    return {kernel.function_name: kernel for kernel in program.all_kernels()}, queue


@pytest.fixture
def stage(device):
    """One slot, so that any hold on it shows; "mem:" lets go of a frame as soon as it is flushed."""
    with pave.Stage(
        device, "mem:", width=SIZE, height=SIZE, channels=CHANNELS, slots=1, timeout=0.1
    ) as stage:
        yield stage


def ramp(channel) -> torch.Tensor:
    return torch.arange(np.prod(channel.shape), dtype=torch.float32).reshape(channel.shape)


@pytest.mark.parametrize("name", CHANNELS)
def test_torch_writes_and_a_kernel_reads(device, kernels, stage, name):
    kernel, queue = kernels[0]["negate"], kernels[1]
    before = pave.copies()
    frame = stage.acquire()
    channel = frame[name]
    channel.torch().copy_(ramp(channel))
    out = np.empty(channel.shape, np.float32)
    target = cl.Buffer(queue.context, cl.mem_flags.WRITE_ONLY, out.nbytes)
    kernel(queue, (out.size,), None, channel.cl_buffer(), target)
    cl.enqueue_copy(queue, out, target)
    np.testing.assert_array_equal(out, -ramp(channel).numpy())
    assert device.slot_access == "shared"
    assert pave.copies() == before


@pytest.mark.parametrize("name", CHANNELS)
def test_a_kernel_writes_and_numpy_and_torch_read(kernels, stage, name):
    kernel, queue = kernels[0]["scale"], kernels[1]
    before = pave.copies()
    frame = stage.acquire()
    channel = frame[name]
    array, tensor, buffer = channel.numpy(), channel.torch(), channel.cl_buffer()
    array[:] = ramp(channel).numpy()
    kernel(queue, (array.size,), None, buffer, np.float32(3))
    queue.finish()
    np.testing.assert_array_equal(array, 3 * ramp(channel).numpy())
    assert torch.equal(tensor, 3 * ramp(channel))
    assert torch.equal(frame[name].torch(), tensor)  # a view made afterwards
    assert pave.copies() == before


@pytest.mark.parametrize("name", CHANNELS)
def test_all_views_have_the_address_that_a_kernel_sees(kernels, stage, name):
    kernel, queue = kernels[0]["where"], kernels[1]
    frame = stage.acquire()
    channel = frame[name]
    seen = np.zeros(1, np.uint64)
    target = cl.Buffer(queue.context, cl.mem_flags.WRITE_ONLY, seen.nbytes)
    kernel(queue, (1,), None, channel.cl_buffer(), target)
    cl.enqueue_copy(queue, seen, target)
    addresses = {
        "kernel": int(seen[0]),
        "numpy": channel.numpy().ctypes.data,
        "asarray": np.asarray(channel).ctypes.data,
        "torch": channel.torch().data_ptr(),
        "torch dlpack": torch.from_dlpack(channel).data_ptr(),
        "numpy dlpack": np.from_dlpack(channel).ctypes.data,
        "frame": frame.torch()[planes_before(frame, name) :].data_ptr(),
    }
    assert set(addresses.values()) == {channel.address}, addresses
    assert channel.address % 4096 == 0


def planes_before(frame, name) -> int:
    names = list(frame)
    return sum(frame[other].shape[0] for other in names[: names.index(name)])


HOLDERS = {
    "frame": lambda frame: pave.Frame(frame._frame),
    "channel": lambda frame: frame["color"],
    "numpy": lambda frame: frame["color"].numpy(),
    "numpy slice": lambda frame: frame["color"].numpy()[1, 3:5, ::2],
    "memoryview": lambda frame: memoryview(frame["depth"].numpy()),
    "torch": lambda frame: frame["albedo"].torch(),
    "torch view": lambda frame: frame["albedo"].torch()[2].t(),
    "whole frame": lambda frame: frame.torch(),
    "dlpack capsule": lambda frame: frame["color"].__dlpack__(),
    "tensor of a capsule": lambda frame: torch.from_dlpack(frame["color"].__dlpack__()),
    "cl buffer": lambda frame: frame["color"].cl_buffer(),
    "metadata": lambda frame: frame.metadata,
    "in a cycle": lambda frame: cycle(frame["color"].numpy()),
}


def cycle(item) -> list:
    ring: list = [item]
    ring.append(ring)
    return ring


@pytest.mark.parametrize("holder", HOLDERS)
def test_a_slot_is_not_reused_while_anything_over_it_lives(stage, holder):
    frame = stage.acquire()
    frame["color"].numpy()[:] = 7
    held = HOLDERS[holder](frame)
    stage.publish(frame)
    stage.flush()
    slot = frame.slot_index
    frame.release()
    with pytest.raises(pave.RunError, match="held by readers"):
        stage.acquire()
    del held
    gc.collect()
    again = stage.acquire()
    assert again.slot_index == slot
    again.release()


def test_a_transfer_on_its_way_holds_the_slot(device, stage):
    """The copy waits at a gate while everything that Python knows of the slot is dropped."""
    context, queue = device.pyopencl()
    frame = stage.acquire()
    frame["color"].numpy()[:] = 11
    gate = cl.UserEvent(context)
    target = cl.Buffer(context, cl.mem_flags.READ_WRITE, frame["color"].byte_size)
    transfer = cl.enqueue_copy(
        queue, target, frame["color"].numpy(), is_blocking=False, wait_for=[gate]
    )
    stage.publish(frame)
    stage.flush()
    frame.release()
    gc.collect()
    with pytest.raises(pave.RunError, match="held by readers"):
        stage.acquire()
    gate.set_status(cl.command_execution_status.COMPLETE)
    transfer.wait()
    del transfer
    gc.collect()
    stage.acquire()["color"].numpy()[:] = 0
    out = np.empty((3, SIZE, SIZE), np.float32)
    cl.enqueue_copy(queue, out, target)
    assert (out == 11).all()


def test_views_outlive_frame_stage_and_device():
    device = pave.Device("cpu")
    stage = pave.Stage(device, "mem:", width=SIZE, height=SIZE, channels=["color"], slots=2)
    frame = stage.acquire()
    tensor, array = frame["color"].torch(), frame["color"].numpy()
    tensor.fill_(5)
    stage.publish(frame)
    stage.close()
    del frame, stage, device
    gc.collect()
    assert float(tensor.sum()) == 5 * tensor.numel()
    array += 1
    assert float(tensor.max()) == 6


def test_released_frame_says_so(stage):
    frame = stage.acquire()
    frame.release()
    frame.release()
    assert "released" in repr(frame)
    with pytest.raises(pave.UsageError, match="released"):
        frame["color"]
    with pytest.raises(pave.UsageError, match="released"):
        stage.publish(frame)


def test_whole_frame_is_one_tensor(stage):
    frame = stage.acquire()
    whole = frame.torch()
    assert whole.shape == (7, SIZE, SIZE)
    assert whole.is_contiguous()
    whole[6].fill_(9)
    assert float(frame["depth"].numpy().min()) == 9


def test_a_padded_frame_is_no_tensor_and_says_why():
    frame = pave.make_frame(None, 20, 10, ["color", "depth"])
    with pytest.raises(pave.UsageError, match=r"20x10.*'depth'.*4096.*multiple of 1024"):
        frame.torch()
    assert frame["depth"].torch().shape == (1, 10, 20)
    assert pave.make_frame(None, 20, 10, ["color"]).torch().shape == (3, 10, 20)


def test_every_copy_is_counted():
    frame = pave.make_frame(None, 8, 4, ["color"])
    channel = frame["color"]
    before = pave.copies()
    copied = channel.numpy(copy=True)
    assert pave.copies() == before + 1
    assert not np.shares_memory(copied, channel.numpy())
    assert np.asarray(channel, dtype=np.float64).dtype == np.float64
    assert pave.copies() == before + 2
    assert not np.shares_memory(np.array(channel, copy=True), channel.numpy())
    assert pave.copies() == before + 3
    assert not np.shares_memory(np.from_dlpack(channel, copy=True), channel.numpy())
    assert pave.copies() == before + 4
    pave.count_copy(3)
    assert pave.copies() == before + 7
    with pytest.raises(ValueError, match="float32"):
        np.asarray(channel, dtype=np.float64, copy=False)
    np.asarray(channel), channel.torch(), torch.from_dlpack(channel), frame.numpy()
    assert pave.copies() == before + 7


def test_dlpack_is_a_cpu_tensor():
    channel = pave.make_frame(None, 8, 4, ["color"])["color"]
    assert channel.__dlpack_device__() == (1, 0)  # kDLCPU
    assert torch.from_dlpack(channel).dtype == torch.float32


def test_wrong_names_list_the_right_ones(stage):
    frame = stage.acquire()
    with pytest.raises(pave.UsageError, match="no channel 'colour'; it has color, albedo, depth"):
        frame["colour"]
    assert "color" in frame
    assert "colour" not in frame
    assert frame.channels == CHANNELS
    with pytest.raises(pave.UsageError, match=r"unknown channel 'heat'.*albedo"):
        pave.make_frame(None, 8, 4, ["heat"])
    assert pave.make_frame(None, 8, 4, [("heat", 2)])["heat"].shape == (2, 4, 8)


def test_known_channels_are_those_of_the_library():
    for name in pave.KNOWN_CHANNELS:
        assert pave._pave.known_channel_planes(name) in (1, 3), name
    with pytest.raises(pave.UsageError) as caught:
        pave.Stage(None, "mem:", channels=[])
    assert caught.value.exit_code == 2


def test_cl_buffer_needs_a_device(device):
    frame = pave.make_frame(None, 8, 4, ["color"])
    with pytest.raises(pave.UsageError, match="not in the memory of an OpenCL device"):
        frame["color"].cl_buffer()
    with pytest.raises(pave.UsageError, match="not in the memory of an OpenCL device"):
        frame["color"].cl_buffer(device)
    other = pave.Device("cpu")  # another context
    frame = pave.make_frame(device, 8, 4, ["color"])
    assert frame["color"].cl_buffer().size == 3 * 8 * 4 * 4
    with pytest.raises(pave.UsageError, match="not in the memory"):
        frame["color"].cl_buffer(other)


def test_metadata_is_a_dict_of_json_values(stage):
    import json

    frame = stage.acquire()
    metadata = frame.metadata
    metadata["scene"] = "cornell"
    metadata["seed"] = 2**64 - 1
    metadata["fov_x_degrees"] = 30
    metadata.update(spp=64, max_depth=50, rr_depth=5)
    plain = json.loads(json.dumps(dict(frame.metadata)))
    assert plain["seed"] == 2**64 - 1
    assert (plain["scene"], plain["spp"]) == ("cornell", 64)
    assert (plain["max_depth"], plain["rr_depth"]) == (50, 5)
    assert len(plain["world_from_camera"]) == 16
    assert frame.view.fov == 30
    for wrong in ({"colour": 1}, {"spp": "many"}, {"spp": 2**40}, {"world_from_camera": [1, 2]}):
        with pytest.raises(pave.UsageError):
            metadata.update(wrong)
    with pytest.raises(KeyError):
        metadata["colour"]
    with pytest.raises(pave.UsageError):
        del metadata["spp"]


def test_a_frames_view_is_a_copy(stage):
    """It neither changes with the next frame in the slot nor holds the slot, of which there is one."""
    frame = stage.acquire()
    frame.metadata["fov_x_degrees"] = 30
    view = frame.view
    matrix = view.matrix
    frame.release()
    frame = stage.acquire()
    frame.metadata.update(fov_x_degrees=50, world_from_camera=range(16))
    assert view.fov == 30
    np.testing.assert_array_equal(view.matrix, matrix)
    assert frame.view.fov == 50


def test_readers_in_threads_see_whole_frames(device):
    """Two readers hold frames for a while; a slot reused too early would show another number in them."""
    frames, slots = 150, 4
    stage = pave.Stage(
        device, "mem:threads", width=SIZE, height=SIZE, channels=["color"], slots=slots, timeout=20
    )
    wrong: list[tuple[int, float, float]] = []
    seen: list[int] = []

    def read(pause: float) -> None:
        with pave.Source("mem:threads") as source:
            while (frame := source.next(timeout=20)) is not None:
                index = frame.metadata["index"]
                tensor = frame["color"].torch()
                del frame
                time.sleep(pause * (index % 3))
                low, high = float(tensor.min()), float(tensor.max())
                if not low == high == index:
                    wrong.append((index, low, high))
                seen.append(index)

    readers = [threading.Thread(target=read, args=(pause,)) for pause in (0.0, 0.002)]
    for reader in readers:
        reader.start()
    for index in range(frames):
        frame = stage.acquire()
        frame["color"].numpy()[:] = index
        stage.publish(frame)
        del frame
    stage.close()
    for reader in readers:
        reader.join(timeout=30)
        assert not reader.is_alive()
    assert wrong == []
    assert sorted(seen) == list(range(frames))


def run_child(body) -> str:
    """What `body` writes in a forked child that must end by itself within 20 s."""
    read_end, write_end = os.pipe()
    pid = os.fork()
    if pid == 0:
        status = 1
        try:
            os.write(write_end, body().encode())
            gc.collect()
            status = 0
        except BaseException as error:
            os.write(write_end, repr(error).encode())
        finally:
            os._exit(status)
    os.close(write_end)
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            break
        time.sleep(0.01)
    else:
        os.kill(pid, 9)
        os.waitpid(pid, 0)
        pytest.fail("the forked child hangs")
    with os.fdopen(read_end) as pipe:
        text = pipe.read()
    assert status == 0, text
    return text


def test_fork_sees_the_pixels_but_no_device(device):
    stage = pave.Stage(device, "mem:fork", width=SIZE, height=SIZE, channels=["color"], slots=2)
    frame = stage.acquire()
    frame["color"].torch().fill_(3)

    def child() -> str:
        nonlocal stage
        lines = [str(float(frame["color"].numpy().sum()))]
        for call in (stage.acquire, stage.close, device.pyopencl):
            try:
                call()
                lines.append("worked")
            except pave.Error as error:
                lines.append(type(error).__name__)
        frame["color"].numpy()[:] = 8  # the child's own pages
        del stage
        return " ".join(lines)

    total = str(float(3 * 3 * SIZE * SIZE))
    assert run_child(child) == f"{total} UsageError UsageError DeviceError"
    assert float(frame["color"].torch().max()) == 3
    stage.publish(frame)
    stage.close()
    assert stage.acknowledged == 1


OTHER_ACCESS = """
    import numpy as np, pave, pyopencl as cl
    device = pave.Device("cpu")
    assert device.slot_access == "{access}"
    context, queue = device.pyopencl()
    program = cl.Program(context, "__kernel void twice(__global float* p) {{ p[get_global_id(0)] *= 2; }}").build()
    frame = pave.make_frame(device, 32, 32, ["color", "depth"])
    frame["color"].numpy()[:] = np.arange(3 * 32 * 32).reshape(3, 32, 32)
    for _ in range(2):
        frame.to_device()
        program.twice(queue, (3 * 32 * 32,), None, frame["color"].cl_buffer())
        frame.to_host()
        assert pave.copies() == 0 or "{access}" == "twin"
    assert (frame["color"].numpy() == 4 * np.arange(3 * 32 * 32).reshape(3, 32, 32)).all()
    print(pave.copies())
"""


@pytest.mark.parametrize(("access", "copies"), [("mapped", 0), ("twin", 8)])
def test_devices_without_shared_bytes_transfer_and_report_it(access, copies):
    """The two other ways of host and kernels to meet, forced on the CPU device: 2 channels, 4 transfers."""
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(OTHER_ACCESS.format(access=access))],
        env={**os.environ, "PAVE_SLOT_ACCESS": access, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 0, result.stderr
    assert int(result.stdout) == copies
