"""Stages and sources from Python: endings, policies, resuming, traces, and the interpreter lock while they wait.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import gc
import json
import threading
import time

import numpy as np
import pytest

import pave


def publish(stage: pave.Stage, count: int) -> None:
    for _ in range(count):
        frame = stage.acquire()
        frame["color"].numpy()[:] = frame.metadata["index"]
        stage.publish(frame)
        frame.release()


def open_stage(uri: str, **options) -> pave.Stage:
    return pave.Stage(None, uri, width=8, height=4, channels=["color"], **options)


def test_counters_and_close(tmp_path):
    stage = open_stage(f"bp:{tmp_path}/a.bp", slots=3)
    publish(stage, 5)
    assert stage.published == 5
    stage.flush()
    assert (stage.acknowledged, stage.dropped, stage.first_index) == (5, 0, 0)
    stage.close()
    stage.close()
    with pytest.raises(pave.UsageError, match="closed"):
        stage.acquire()
    source = pave.Source(stage.uri)
    assert source.finished
    assert [int(frame["color"].numpy()[0, 0, 0]) for frame in source] == [0, 1, 2, 3, 4]


def test_an_exception_in_the_block_leaves_the_set_open_for_resume(tmp_path):
    uri = f"bp:{tmp_path}/a.bp"

    def fail() -> None:
        with open_stage(uri) as stage:
            publish(stage, 2)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    source = pave.Source(uri, allow_unfinished=True)
    assert (len(source), source.finished) == (2, False)
    with open_stage(uri, resume=True) as stage:
        assert stage.first_index == 2
        publish(stage, 1)
    source = pave.Source(uri)
    assert (len(source), source.finished) == (3, True)


@pytest.mark.parametrize("scheme", ["bp", "exr"])
def test_a_dropped_stage_keeps_its_frames_but_is_not_finished(tmp_path, scheme):
    uri = f"{scheme}:{tmp_path}/a"
    stage = open_stage(uri)
    publish(stage, 2)
    del stage
    gc.collect()
    source = pave.Source(uri, allow_unfinished=True)
    assert (len(source), source.finished) == (2, False)


def test_drop_policies():
    with open_stage("mem:newest", slots=2, policy="drop-newest") as stage:
        publish(stage, 5)
        stage.flush()
        assert stage.dropped > 0
    with open_stage("mem:oldest", slots=3, policy="drop-oldest") as stage:
        publish(stage, 9)
        stage.flush()
        source = pave.Source("mem:oldest")
        assert source.metadata(len(source) - 1)["index"] == 8


def test_drop_newest_lets_go_of_what_it_dropped():
    """Without release(): the loop's own variable must not hold the slot that the next acquire() needs."""
    with open_stage("mem:busy", slots=2, policy="drop-newest", timeout=5) as stage:
        for index in range(6):
            frame = stage.acquire()
            kept = frame["color"].numpy()
            kept[:] = index
            del kept
            stage.publish(frame)
        with pytest.raises(pave.UsageError, match="released"):
            frame["color"]
        stage.flush()
        assert (stage.published, stage.acknowledged, stage.dropped) == (6, 1, 5)


def test_next_takes_frames_in_order_and_ends():
    stage = open_stage("mem:next", slots=4)
    publish(stage, 4)
    stage.flush()
    source = pave.Source("mem:next")
    taken = [source.next(timeout=1) for _ in range(4)]
    assert [frame.metadata["index"] for frame in taken] == [0, 1, 2, 3]
    del taken
    publish(stage, 1)
    stage.close()
    assert source.next(timeout=1).metadata["index"] == 4
    assert source.next(timeout=1) is None


def test_others_run_while_a_stage_waits():
    """acquire() waits for 0.5 s; a thread counts meanwhile, which it could not with the lock held."""
    stage = open_stage("mem:", slots=1, timeout=0.5)
    held = stage.acquire()
    ticks = []
    done = threading.Event()

    def count() -> None:
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.01)

    counter = threading.Thread(target=count)
    begin = time.monotonic()
    counter.start()
    with pytest.raises(pave.RunError, match="no free slot"):
        stage.acquire()
    end = time.monotonic()
    done.set()
    counter.join()
    assert held
    assert sum(begin < tick < end for tick in ticks) >= 10


def test_trace_shows_python_and_background_spans(tmp_path):
    trace = pave.Trace()
    trace.name_thread("producer")
    with open_stage(f"bp:{tmp_path}/a.bp", trace=trace) as stage, trace.span("loop", "two frames"):
        publish(stage, 2)
    with pytest.raises(KeyError), trace.span("fails"):
        raise KeyError
    trace.write(tmp_path / "trace.json")
    events = json.loads((tmp_path / "trace.json").read_text())
    events = events["traceEvents"] if isinstance(events, dict) else events
    spans = {event["name"]: event for event in events if event.get("ph") == "X"}
    assert {"loop", "fails", "publish"} <= set(spans)
    loop, inner = spans["loop"], spans["publish"]
    assert loop["ts"] <= inner["ts"]  # one clock on both sides
    assert inner["ts"] + inner["dur"] <= loop["ts"] + loop["dur"]
    with pytest.raises(pave.RunError):
        trace.write(tmp_path / "no" / "folder" / "trace.json")


@pytest.mark.parametrize("names", ["pave", "oidn", "cycles"])
def test_exr_of_one_frame(tmp_path, names):
    frame = pave.make_frame(None, 7, 5, ["color", "depth", "normal"])
    for number, name in enumerate(frame):
        frame[name].numpy()[:] = np.random.Generator(np.random.PCG64(number)).normal(
            size=frame[name].shape
        )
    frame["depth"].numpy()[0, 0, 0] = np.inf
    frame.metadata["scene"] = "cornell"
    pave.write_exr(frame, tmp_path / "x.exr", names)
    back = pave.read_exr(tmp_path / "x.exr")
    assert back.metadata["scene"] == "cornell"
    for name in frame:
        np.testing.assert_array_equal(back[name].numpy(), frame[name].numpy())
    with pytest.raises(pave.UsageError):
        pave.write_exr(frame, tmp_path / "y.exr", "blender")
    assert not (tmp_path / "y.exr").exists()


def test_frames_of_files_into_a_device(tmp_path):
    uri = f"bp:{tmp_path}/a.bp"
    with open_stage(uri) as stage:
        publish(stage, 1)
    device = pave.Device("cpu")
    frame = pave.Source(uri, device=device).read(0)
    assert frame.device is device
    assert frame["color"].cl_buffer().size == 3 * 8 * 4 * 4
