"""`pave demo`: the papers' experiment in small, from nothing to a report, and on from where it was stopped.

SPDX-License-Identifier: BSD-3-Clause
"""

import csv
import json
import math
import signal
import time

import pytest
from command import pave, start
from test_parity import TOLERANCE

import pave as library
from pave import demo as module
from pave import drawing
from pave.console import Console
from pave.demo import DemoSetting, run_demo

QUICK_LIMIT_S = 180  # on two cores that nobody else uses; the test allows twice that

# The experiment at its smallest, for what does not depend on its size.
TINY = {"epochs": 2, "filters": 4, "unet_depth": 2, "d_filters": 4, "d_layers": 2, "threads": 1}


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Folder and record of one quick demo, interrupted in its training once."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    begin = time.monotonic()
    process = start("demo", folder, "--quick", "--json")
    for line in process.stdout:
        event = json.loads(line)
        if event.get("stage") == "train" and event.get("step", 0) >= 10:
            process.send_signal(signal.SIGINT)
            break
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1, err
    outcome = pave("demo", folder, "--quick", "--json", limit_s=2 * QUICK_LIMIT_S)
    assert outcome.code == 0, outcome.err
    return folder, outcome, time.monotonic() - begin


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_quick_demo(demo):
    folder, outcome, seconds = demo
    assert seconds < 2 * QUICK_LIMIT_S
    record = outcome.records[-1]
    for key in ("psnr", "ssim", "baseline_psnr", "novel_psnr", "d_real", "d_fake"):
        assert math.isfinite(record[key]), key
    assert all(value >= 0 for value in record["seconds"].values())
    # Some hundred steps on small images learn less than the full demo, but more than nothing.
    assert record["psnr"] > record["baseline_psnr"]
    for name in (
        "report.html", "figures/overview.png", "run/generator.safetensors", "run/generator.json",
        "run/loss.png",
    ):  # fmt: skip
        assert (folder / name).stat().st_size > 0, name
    assert library.Source(f"bp:{folder / 'cornell.bp'}").finished
    assert library.Source(f"bp:{folder / 'novel.bp'}").finished


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_renderer_draws_what_torch_draws(demo):
    """From the same buffers, and as close as two float32 networks are; then the scores agree too."""
    from pave.export import load_generator
    from pave.transfer import compressed_peak

    folder, outcome, _ = demo
    drawn = outcome.records[-1]["drawn"]
    assert drawn["same_buffers"]
    # test_parity's bound is of encoded images; shown they are larger by the peak that encoding divides by, and the sRGB
    # curve is what encoding is, so nothing else is added.
    bound = TOLERANCE * compressed_peak(load_generator(folder / "run").schema.peak)
    assert bound < 1e-3
    assert 0 <= drawn["torch_difference"] <= bound
    with open(folder / "run" / "evaluation.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["split"] == "test"]
    scores = [float(row["generated_psnr"]) for row in rows[: drawn["views"]]]
    # An image that differs by d at most has an RMSE that differs by d at most.
    rmse = min(10 ** (-score / 20) for score in scores)
    slack = -20 * math.log10(1 - drawn["torch_difference"] / rmse)
    assert drawn["psnr"] == pytest.approx(sum(scores) / len(scores), abs=slack + 1e-4)
    # From fewer samples it still draws more than the baselines show; the path traced image beside it is of equal time.
    fast = drawn["fast"]
    assert fast["psnr"] > outcome.records[-1]["baseline_psnr"]
    assert fast["equal_time_path_traced"]["spp"] >= 1
    assert math.isfinite(fast["equal_time_path_traced"]["psnr"])


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_report_stands_alone(demo):
    from pave.report import check_report

    assert check_report(demo[0] / "report.html") == []


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_second_call_renders_and_trains_nothing(demo):
    folder, first, _ = demo
    begin = time.monotonic()
    again = pave("demo", folder, "--quick", "--json", limit_s=QUICK_LIMIT_S)
    assert again.code == 0, again.err
    assert time.monotonic() - begin < QUICK_LIMIT_S / 2
    assert again.records[-1]["psnr"] == pytest.approx(first.records[-1]["psnr"], abs=1e-6)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_folder_of_other_settings_is_left_alone(demo):
    outcome = pave("demo", demo[0], "--quick", "--seed", "9")
    assert outcome.code == 2, outcome.err
    assert str(demo[0]) in outcome.err


# The same in small, without a process of its own -------------------------------------------------------------------------


@pytest.fixture
def tiny(monkeypatch, tmp_path):
    """Runs a demo of a few tiny images into a folder, as JSON; returns its record."""
    setting = DemoSetting(views=10, novel_views=2, size=12, spp=2, max_depth=4, training=TINY)
    monkeypatch.setitem(module.SETTINGS, "tiny", setting)
    return lambda folder=tmp_path / "out", **options: run_demo(
        Console(json_lines=True), folder, "tiny", **options
    )


def read(path):
    return json.loads(path.read_text())


def test_every_stage_tells_its_progress(tiny, tmp_path, capsys):
    record = tiny(seed=2**64 - 1)
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    counts = {}
    for event in events:
        for unit in ("frames", "images", "views", "pictures", "step"):
            if unit in event:
                counts.setdefault(event["stage"], []).append(event[unit])
    assert counts == {
        "render": [*range(1, 11), 1, 2],
        "train": [0, 3, 6],
        "evaluate": list(range(1, 6 + 10 + 2 + 1)),
        "draw": [1, 2],
        "report": [1, 2, 3, 4],
    }
    names = ["render", "render novel scene", "train", "evaluate", "draw", "report"]
    assert [event["stage"] for event in events if set(event) == {"stage", "seconds"}] == names
    assert list(record["seconds"]) == names
    assert read(tmp_path / "out" / "seconds.json")["done"] == sorted(names)


def test_discriminator_and_provenance_are_those_of_what_is_shown(tiny, tmp_path):
    record = tiny()
    best = read(tmp_path / "out" / "run" / "generator.json")["training"]["best"]
    assert (record["d_real"], record["d_fake"]) == (best["val_d_real"], best["val_d_fake"])
    page = (tmp_path / "out" / "report.html").read_text()
    assert f"<b>{record['d_real']:.2f} / {record['d_fake']:.2f}</b>" in page
    novel = library.Source(f"bp:{tmp_path / 'out' / 'novel.bp'}").metadata(0)
    assert "novel scene.scene_hash" in page
    assert novel["scene_hash"] in page


def test_seconds_add_up_over_calls_and_the_trace_is_always_there(tiny, tmp_path, monkeypatch):
    real = module._Demo.draw

    def interrupted(*_):
        time.sleep(0.5)
        raise KeyboardInterrupt("SIGINT")

    monkeypatch.setattr(module._Demo, "draw", interrupted)
    with pytest.raises(KeyboardInterrupt):
        tiny()
    folder = tmp_path / "out"
    first = read(folder / "seconds.json")
    assert "draw" not in first["done"]
    assert first["seconds"]["draw"] >= 0.5
    names = {event.get("name") for event in read(folder / "trace.json")["traceEvents"]}
    assert {"render", "train", "draw"} <= names
    monkeypatch.setattr(module._Demo, "draw", real)
    record = tiny()
    assert record["seconds"]["draw"] > first["seconds"]["draw"]
    for name in ("render", "train", "evaluate"):
        assert record["seconds"][name] == first["seconds"][name], (
            "a step done before keeps its time"
        )
    assert read(folder / "seconds.json")["seconds"] == record["seconds"]
    again = tiny()
    assert again["seconds"] == record["seconds"]
    assert again["psnr"] == record["psnr"]


def test_other_buffers_than_those_trained_on_fail_the_demo(tiny, monkeypatch):
    monkeypatch.setattr(drawing, "cheap_depth", lambda _: 1)
    with pytest.raises(library.RunError, match="another 'direct'"):
        tiny()


def test_a_folder_that_is_damaged_or_another_is_left_alone(tiny, tmp_path):
    folder = tmp_path / "out"
    tiny(seed=3)
    with pytest.raises(library.UsageError, match="another setting"):
        tiny(seed=4)
    (folder / "seconds.json").write_text('{"seconds": []}')
    with pytest.raises(library.InputError, match=r"seconds\.json"):
        tiny(seed=3)
    other = tmp_path / "other"
    other.mkdir()
    (other / "letter.txt").write_text("dear")
    with pytest.raises(library.UsageError, match="holds no demo"):
        tiny(other)
    assert [path.name for path in other.iterdir()] == ["letter.txt"]
