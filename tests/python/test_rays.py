"""Ray queries from Python: arrays in place, OpenCL buffers, and what is refused.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import numpy as np
import pyopencl as cl
import pytest

import pave
from pave.rays import HIT, RAY, make_rays


@pytest.fixture(scope="module")
def device():
    return pave.Device("cpu")


@pytest.fixture(scope="module")
def tracer(device):
    return pave.RayTracer(device, pave.load_scene("cornell"))


@pytest.fixture(scope="module")
def rays():
    rng = np.random.default_rng(7)
    scene = pave.load_scene("cornell")
    low, high = np.array(scene.bounds_min), np.array(scene.bounds_max)
    return make_rays(rng.uniform(low, high, (1000, 3)), rng.normal(size=(1000, 3)))


def test_every_lane_width_gives_the_same(device, tracer, rays):
    expected = tracer.trace_closest(rays)
    assert expected.dtype == HIT
    assert (expected["shape"] >= 0).mean() > 0.5  # the box is open on one side
    for lanes in (1, 4, 8, 16):
        hits = pave.RayTracer(device, pave.load_scene("cornell"), lane_width=lanes).trace_closest(
            rays
        )
        # Wide lanes' reciprocals round another way.
        np.testing.assert_allclose(hits["t"], expected["t"], rtol=1e-6)


def test_any_agrees_with_closest_and_t_max_cuts(tracer, rays):
    hits = tracer.trace_closest(rays)
    np.testing.assert_array_equal(tracer.trace_any(rays), hits["shape"] >= 0)
    shorter = rays.copy()
    shorter["t_max"] = hits["t"] * np.float32(0.999)
    assert not tracer.trace_any(shorter).any()
    assert (tracer.trace_closest(shorter)["shape"] == -1).all()


def test_plain_floats_and_results_in_place(tracer, rays):
    plain = rays.view(np.float32).reshape(-1, 8)
    out = np.zeros(len(rays), HIT)
    assert tracer.trace_closest(plain, out) is out
    np.testing.assert_array_equal(out, tracer.trace_closest(rays))
    flags = np.zeros(len(rays), np.bool_)
    assert tracer.trace_any(plain, flags) is flags


def test_pyopencl_buffers(device, tracer, rays):
    context, queue = device.pyopencl()
    flags = cl.mem_flags
    given = cl.Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=rays)
    taken = cl.Buffer(context, flags.READ_WRITE, len(rays) * HIT.itemsize)
    tracer.enqueue_closest(given, taken, len(rays))
    hits = np.empty(len(rays), HIT)
    cl.enqueue_copy(queue, hits, taken)
    np.testing.assert_array_equal(hits, tracer.trace_closest(rays))
    with pytest.raises(pave.UsageError, match="are needed"):
        tracer.enqueue_closest(given, taken, len(rays) + 1)
    with pytest.raises(pave.UsageError, match=r"pyopencl\.Buffer"):
        tracer.enqueue_any(rays, taken, 1)


def test_make_rays():
    rays = make_rays([0, 0, 0], [[0, 0, 1], [0, 1, 0]], [1, 2])
    assert rays.dtype == RAY
    assert rays["t_max"].tolist() == [1, 2]
    assert rays["direction"][1].tolist() == [0, 1, 0]
    for bad in (([0, 0], [0, 0, 1]), ([[0, 0, 0]] * 2, [[0, 0, 1]] * 3), ("x", [0, 0, 1])):
        with pytest.raises(pave.UsageError):
            make_rays(*bad)


def test_refuses_other_arrays(tracer, rays):
    read_only = np.zeros(len(rays), HIT)
    read_only.flags.writeable = False
    for bad in (rays[::2], rays["origin"], np.zeros((3, 8)), [1, 2, 3]):
        with pytest.raises(pave.UsageError):
            tracer.trace_closest(bad)
    for out in (np.zeros(3, HIT), read_only, np.zeros(len(rays), np.int32)):
        with pytest.raises(pave.UsageError):
            tracer.trace_closest(rays, out)
    with pytest.raises(pave.UsageError):
        tracer.trace_any(rays, np.zeros(len(rays), np.uint8))
    with pytest.raises(pave.UsageError, match="lane_width"):
        pave.RayTracer(tracer.device, pave.load_scene("cornell"), lane_width=3)
