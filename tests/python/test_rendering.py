"""The renderer and the generator from Python: in place, without the interpreter lock, and stopped by Ctrl-C.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import hashlib
import os
import signal
import threading
import time

import numpy as np
import pyopencl as cl
import pytest

import pave

CHANNELS = ["color", "albedo", "direct", "normal", "depth"]
SIZE = 32


@pytest.fixture(scope="module")
def device():
    return pave.Device("cpu")


@pytest.fixture(scope="module")
def scene():
    return pave.load_scene("cornell")


@pytest.fixture(scope="module")
def renderer(device, scene):
    return pave.Renderer(device, scene)


def new_frame(device) -> pave.Frame:
    return pave.make_frame(device, SIZE, SIZE, CHANNELS)


def digest(frame: pave.Frame) -> str:
    sha = hashlib.sha256()
    for name in frame:
        sha.update(frame[name].numpy().tobytes())
    return sha.hexdigest()


def test_views():
    view = pave.look_at((0, 1, -5), (0, 1, 0), fov=35)
    assert view.matrix.shape == (4, 4)
    np.testing.assert_allclose(view.matrix[:3, 2], [0, 0, 1], atol=1e-6)  # +Z along the view
    np.testing.assert_allclose(view.matrix[:3, 0], [1, 0, 0], atol=1e-6)  # +X left: up x forward
    np.testing.assert_allclose(view.matrix[:3, 3], [0, 1, -5])
    assert view.fov == 35
    assert pave.View(view.matrix, 35) == view
    assert hash(pave.View(view.matrix, 35)) == hash(view)
    assert pave.View(view.matrix, 36) != view


def test_hemisphere_views_do_not_depend_on_those_after_them(scene):
    views = pave.hemisphere_views(scene, 20, seed=3)
    assert pave.hemisphere_views(scene, 5, seed=3) == views[:5]
    assert pave.hemisphere_views(scene, 5, seed=4) != views[:5]
    assert len(set(views)) == 20


def test_the_frame_is_filled_in_place_with_its_metadata(device, scene, renderer):
    before = pave.copies()
    frame = new_frame(device)
    color = frame["color"].torch()
    renderer.render(None, frame, spp=4, max_depth=4, seed=7, frame_index=12)
    assert float(color.mean()) > 0
    assert pave.copies() == before
    metadata = frame.metadata
    assert (metadata["spp"], metadata["max_depth"], metadata["seed"]) == (4, 4, 7)
    assert (metadata["index"], metadata["scene"]) == (12, "cornell")
    assert metadata["scene_hash"] == scene.hash
    assert metadata["kernel_hash"] == pave.kernel_hash()
    assert metadata["program_version"] == pave.__version__
    assert metadata["seconds_spent"] > 0
    assert frame.view == scene.view
    assert renderer.dropped_samples == 0


def test_schedule_and_context_do_not_change_a_bit(device, scene, renderer):
    """The same bits from a context that pyopencl made, and from frames in host memory (a copy, and counted)."""
    options = {"spp": 3, "max_depth": 6, "seed": 5, "frame_index": 2}
    frame = new_frame(device)
    renderer.render(None, frame, **options)
    expected = digest(frame)
    renderer.render(None, frame, tile_rows=5, **options)
    assert digest(frame) == expected

    platform, number = map(int, device.profile.id.split(":"))
    context = cl.Context([cl.get_platforms()[platform].get_devices()[number]])
    queue = cl.CommandQueue(context)
    theirs = pave.Device.from_pyopencl(context, queue)
    other = new_frame(theirs)
    pave.Renderer(theirs, scene).render(None, other, **options)
    assert digest(other) == expected
    color = np.empty((3, SIZE, SIZE), np.float32)
    cl.enqueue_copy(queue, color, other["color"].cl_buffer())
    np.testing.assert_array_equal(color, frame["color"].numpy())

    before = pave.copies()
    host = new_frame(None)
    renderer.render(None, host, **options)
    assert digest(host) == expected
    assert pave.copies() == before + len(CHANNELS)

    renderer.render(None, frame, **{**options, "seed": 6})
    assert digest(frame) != expected


def test_progress_rises_and_can_cancel(device, renderer):
    seen: list[float] = []
    frame = new_frame(device)
    renderer.render(None, frame, spp=8, tile_rows=4, progress=seen.append)
    assert len(seen) > 1
    assert seen == sorted(seen)
    assert seen[0] >= 0
    assert seen[-1] <= 1
    with pytest.raises(pave.RunError):
        renderer.render(None, frame, spp=8, tile_rows=4, progress=lambda done: False)

    def fail(done: float) -> None:
        raise LookupError("mine")

    with pytest.raises(LookupError, match="mine"):
        renderer.render(None, frame, spp=8, tile_rows=4, progress=fail)
    with pytest.raises(pave.UsageError, match="own progress callback"):
        renderer.render(
            None,
            frame,
            tile_rows=4,
            progress=lambda done: renderer.render(None, frame, spp=1),
        )
    renderer.render(None, frame, spp=1)  # still usable


def test_ctrl_c_stops_a_long_render(device, renderer):
    """SIGINT after 0.3 s, in a render that would take hours."""
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    begin = time.monotonic()
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        renderer.render(None, new_frame(device), spp=2**24 - 1, tile_rows=1)
    timer.cancel()
    assert time.monotonic() - begin < 30


def test_others_run_while_it_renders(device, renderer):
    ticks: list[float] = []
    done = threading.Event()

    def count() -> None:
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.005)

    counter = threading.Thread(target=count)
    counter.start()
    begin = time.monotonic()
    renderer.render(None, new_frame(device), spp=400, max_depth=50)
    end = time.monotonic()
    done.set()
    counter.join()
    held = max(np.diff([begin, *(t for t in ticks if begin < t < end), end]))
    assert held < max(0.25, 0.5 * (end - begin)), f"no other thread ran for {held:.2f} s"


def test_threads_take_turns(device, renderer):
    """Two threads on one renderer: each frame is the one that its own seed makes."""
    alone = {}
    for seed in (1, 2):
        frame = new_frame(device)
        renderer.render(None, frame, spp=4, seed=seed)
        alone[seed] = digest(frame)
    found: dict[int, str] = {}

    def render(seed: int) -> None:
        frame = new_frame(device)
        for _ in range(3):
            renderer.render(None, frame, spp=4, seed=seed)
        found[seed] = digest(frame)

    threads = [threading.Thread(target=render, args=(seed,)) for seed in alone]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == alone


@pytest.mark.parametrize(
    "wrong",
    [
        {"spp": 0},
        {"spp": 2**40},
        {"max_depth": 0},
        {"seed": -1},
        {"seed": 2**64},
        {"lane_width": 3},
    ],
)
def test_options_out_of_range(device, renderer, wrong):
    with pytest.raises(pave.UsageError):
        renderer.render(None, new_frame(device), **wrong)


def test_a_broken_kernel_tells_file_line_and_log(tmp_path, monkeypatch, device, scene):
    import shutil
    from pathlib import Path

    folder = tmp_path / "kernels"
    shutil.copytree(Path(__file__).parents[2] / "kernels", folder)
    with open(folder / "path.cl", "a") as kernel:
        kernel.write("\n__kernel void broken(void) { int x = not_there; }\n")
    monkeypatch.setenv("PAVE_KERNEL_DIR", str(folder))
    with pytest.raises(pave.ClError) as caught:
        pave.Renderer(device, scene).render(None, new_frame(device), spp=1)
    error = caught.value
    assert error.exit_code == 4
    assert error.routine == "clBuildProgram"
    assert error.code < 0
    assert "path.cl:" in str(error)
    assert "\n" not in str(error)
    assert "not_there" in error.build_log


def test_frames_have_one_sha256_whatever_the_slots(device, scene, renderer):
    """Through rings of other sizes, in slots used again and again, also in tiles of one row."""
    views = pave.hemisphere_views(scene, 7, 3)
    found = set()
    for slots, tile_rows in ((2, 1), (3, 0), (5, 3), (8, 0)):
        stage = pave.Stage(
            device,
            "mem:",
            width=SIZE,
            height=SIZE,
            channels=CHANNELS,
            slots=slots,
            policy="drop-oldest",
        )
        digests = []
        for index, view in enumerate(views):
            frame = stage.acquire()
            frame["color"].numpy()[:] = np.nan  # what an earlier frame left must not matter
            renderer.render(
                view, frame, spp=8, max_depth=8, seed=5, frame_index=index, tile_rows=tile_rows
            )
            digests.append(digest(frame))
            stage.publish(frame)
            del frame
        stage.close()
        found.add(tuple(digests))
    assert len(found) == 1
    assert len(set(digests)) == len(views)
