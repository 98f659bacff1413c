"""The command line: what each command prints, writes and returns, also when it is interrupted.

SPDX-License-Identifier: BSD-3-Clause
"""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command import PAVE, ROOT, environment, pave, start

import pave as library

COMMANDS = (
    "doctor", "devices", "render", "dataset", "info", "train", "evaluate", "infer", "demo",
)  # fmt: skip
TINY = ("--size", "16x8", "--spp", "2", "--max-depth", "3")


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty folder that commands run in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_help_of_everything():
    outcome = pave("-h")
    assert outcome.code == 0
    for command in COMMANDS:
        assert command in outcome.out
        one = pave(command, "-h")
        assert one.code == 0, command
        assert "--json" in one.out, command


def test_help_of_train_states_the_defaults_of_the_library():
    from pave.options import TrainOptions

    text = " ".join(pave("train", "-h", COLUMNS="200").out.split())
    for option, name in (
        ("--epochs", "epochs"), ("--batch", "batch"), ("--lr", "lr"), ("--beta1", "beta1"),
        ("--beta2", "beta2"), ("--l1-weight", "l1_weight"), ("--gan-mode", "gan_mode"),
        ("--adversarial-weight", "adversarial_weight"), ("--filters", "filters"),
        ("--unet-depth", "unet_depth"), ("--norm", "norm"), ("--head", "head"), ("--best", "best"),
        ("--repeat-depth", "repeat_depth"), ("--threads", "threads"), ("--torch-device", "device"),
        ("--checkpoint-seconds", "checkpoint_seconds"), ("--seed", "seed"),
    ):  # fmt: skip
        shown = re.search(rf" {option} .*?\[default: (.*?)\]", text)
        assert shown, option
        assert shown.group(1) == str(getattr(TrainOptions, name)), option
    assert ",".join(TrainOptions.inputs) in text
    assert "--minutes" in text
    assert "--mirror" in text


def test_train_options_reach_the_run(place):
    small = ("--size", "12x12", "--spp", "1", "--max-depth", "3", "--views", "6")
    assert pave("dataset", "cornell", "bp:d.bp", *small).code == 0
    given = {
        "best": "l1", "repeat_depth": 3, "minutes": 0.01, "adversarial_weight": 0.5,
        "checkpoint_seconds": 5.0, "threads": 1, "mirror": True, "filters": 4, "unet_depth": 3,
    }  # fmt: skip
    words = []
    for name, value in given.items():
        words += [f"--{name.replace('_', '-')}", *([] if value is True else [value])]
    done = pave("train", "bp:d.bp", "-o", "run", *words, "--json")
    assert done.code == 0, done.err
    config = json.loads((place / "run" / "config.json").read_text())
    assert {name: config["options"][name] for name in given} == given
    assert config["schema"]["inputs"][-1]["repeat"] == 3


def test_no_command_is_a_usage_error():
    assert pave().code == 2


def test_start_loads_no_heavy_module():
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "pave", "render", "-h"],
        capture_output=True,
        text=True,
        timeout=60,
        env=environment(),
    )
    modules = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "pave.cli" in modules
    assert not modules & {"torch", "numpy", "matplotlib", "pyopencl", "adios2", "PIL"}


def test_devices():
    outcome = pave("devices", "--json")
    assert outcome.code == 0, outcome.err
    assert outcome.err == ""
    assert [record["id"] for record in outcome.records] == [d.id for d in library.devices()]


def test_doctor_finds_nothing_to_mend():
    outcome = pave("doctor", "--json")
    assert outcome.code == 0, outcome.out
    assert {"pave", "render", "torch"} <= {record["check"] for record in outcome.records}
    assert all(record["ok"] for record in outcome.records)


def test_doctor_says_where_kernels_are_kept_or_why_not(tmp_path):
    def cache(**environment):
        records = pave("doctor", "--json", **environment).records
        (record,) = (record for record in records if record["check"] == "kernel cache")
        return record["detail"]

    folder = tmp_path / "cache"
    assert cache(PAVE_CACHE_DIR=str(folder)) == str(folder)
    folder.chmod(0o777)
    assert "chmod 700" in cache(PAVE_CACHE_DIR=str(folder))


def test_render_writes_what_the_library_renders(place):
    outcome = pave("render", "cornell", "-o", "x.exr", *TINY, "--seed", "5", "--json")
    assert outcome.code == 0, outcome.err
    (record,) = outcome.records
    assert record["size"] == [16, 8]
    assert (record["spp"], record["max_depth"], record["seed"]) == (2, 3, 5)
    assert [path.name for path in place.iterdir()] == ["x.exr"]

    device, scene = library.Device(), library.load_scene("cornell")
    stored = library.read_exr("x.exr")
    assert stored.channels == ("color", "albedo", "direct", "normal", "depth", "variance")
    assert stored.metadata["scene_hash"] == scene.hash
    frame = library.make_frame(device, 16, 8, list(stored.channels))
    library.Renderer(device, scene).render(
        scene.view, frame, spp=2, max_depth=3, seed=5, frame_index=0
    )
    for name in frame.channels:
        np.testing.assert_array_equal(frame[name].numpy(), stored[name].numpy(), err_msg=name)


def test_triangles_without_area_are_reported(place):
    # One so small that float32 has no normal for it.
    place.joinpath("thin.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1e-10 0 0\nv 0 1e-10 0\nf 1 2 3\nf 1 4 5\n"
    )
    scene = (ROOT / "scenes" / "cornell.xml").read_text()
    shape = '<shape type="obj"><string name="filename" value="thin.obj"/></shape>\n</scene>'
    place.joinpath("thin.xml").write_text(scene.replace("</scene>", shape))
    outcome = pave("render", "thin.xml", "-o", "x.png", *TINY)
    assert outcome.code == 0, outcome.err
    assert "pave: warning: triangles without area, left out: 1" in outcome.err
    outcome = pave("dataset", "thin.xml", "bp:x.bp", "--views", "1", *TINY, "--json")
    assert outcome.code == 0, outcome.err
    assert outcome.records[-1]["warnings"] == ["triangles without area, left out: 1"]


def test_render_again_replaces_the_image_with_the_same_bytes(place):
    contents = []
    for _ in range(2):
        assert pave("render", "cornell", "-o", "x.png", *TINY).code == 0
        contents.append((place / "x.png").read_bytes())
    assert contents[0] == contents[1]
    assert [path.name for path in place.iterdir()] == ["x.png"]


def test_render_png_is_the_srgb_image(place):
    from PIL import Image

    outcome = pave("render", "cornell", "-o", "x.exr", *TINY)
    assert outcome.code == 0, outcome.err
    assert pave("render", "cornell", "-o", "x.png", *TINY).code == 0
    linear = np.clip(library.read_exr("x.exr")["color"].numpy().astype(np.float64), 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    pixels = np.asarray(Image.open("x.png")).transpose(2, 0, 1).astype(np.float64)
    assert pixels.shape == (3, 8, 16)
    assert np.abs(pixels - 255 * srgb).max() <= 0.51


def test_render_takes_size_and_samples_from_the_scene_and_defines(place):
    outcome = pave(
        "render", "cornell", "-o", "x.exr", "-D", "size=12", "-D", "spp=3", "--max-depth", "2",
        "--channels", "depth,object", "--json",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    assert outcome.records[0]["size"] == [12, 12]
    assert outcome.records[0]["spp"] == 3
    assert library.read_exr("x.exr").channels == ("depth", "object")


def test_nothing_but_json_on_stdout_and_no_bar_in_a_pipe(place):
    plain = pave("dataset", "cornell", "bp:a.bp", *TINY, "--views", "3")
    assert plain.code == 0, plain.err
    assert "\x1b" not in plain.out + plain.err
    assert "\r" not in plain.out + plain.err
    machine = pave("dataset", "cornell", "bp:b.bp", *TINY, "--views", "3", "--json")
    assert machine.code == 0, machine.err
    counts = [record["acknowledged"] for record in machine.records]
    assert counts == sorted(counts)
    assert counts[-1] == 3
    assert machine.records[-1]["uri"] == "bp:b.bp"


def test_dataset_is_the_same_in_every_sink_and_info_verifies_it(place):
    records = []
    for uri in ("bp:a.bp", "exr:b"):
        done = pave("dataset", "cornell", uri, *TINY, "--views", "5", "--frames-per-shard", "2")
        assert done.code == 0, done.err
        records += pave("info", uri, "--json").records
    first, second = records
    assert first["frames"] == second["frames"] == 5
    assert first["finished"]
    assert first["verified"]
    assert first["content_hash"] == second["content_hash"]
    assert first["channels"] == ["color", "albedo", "direct", "normal", "depth", "variance"]
    assert first["first_frame"]["scene"] == "cornell"
    assert first["first_frame"]["spp"] == 2


def test_views_file(place):
    views = [
        {"eye": [0, 0, 3], "target": [0, 0, 0]},
        {"eye": [0, 1, 3], "target": [0, 0, 0], "fov": 55},
    ]
    (place / "views.json").write_text(json.dumps(views))
    done = pave("dataset", "cornell", "exr:d", *TINY, "--views-file", "views.json")
    assert done.code == 0, done.err
    source = library.Source("exr:d")
    assert len(source) == 2
    assert source.read(1).view == library.look_at((0, 1, 3), (0, 0, 0), fov=55)


def test_trace_shows_rendering_and_saving_at_once(place):
    done = pave(
        "dataset", "cornell", "bp:d.bp", "--size", "64x64", "--spp", "16", "--views", "12",
        "--slots", "4", "--frames-per-shard", "2", "--trace", "trace.json",
    )  # fmt: skip
    assert done.code == 0, done.err
    trace = json.loads((place / "trace.json").read_text())
    events = [
        e for e in (trace["traceEvents"] if isinstance(trace, dict) else trace) if e["ph"] == "X"
    ]
    renders = [e for e in events if e["name"] == "render"]
    others = [e for e in events if e["tid"] != renders[0]["tid"]]
    assert len(renders) == 12
    assert others
    overlap = sum(
        max(0, min(a["ts"] + a["dur"], b["ts"] + b["dur"]) - max(a["ts"], b["ts"]))
        for a in renders
        for b in others
    )
    assert overlap > 0


def test_resume_of_a_finished_data_set_changes_nothing(place):
    words = ("dataset", "cornell", "bp:d.bp", *TINY, "--views", "4")
    assert pave(*words).code == 0
    before = (place / "d.bp" / "manifest.jsonl").read_bytes()
    again = pave(*words, "--resume", "--json")
    assert again.code == 0, again.err
    assert again.records[-1]["acknowledged"] == 4
    assert (place / "d.bp" / "manifest.jsonl").read_bytes() == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_data_set_ends_soon_and_can_go_on(place, number):
    words = (
        "dataset", "cornell", "bp:d.bp", "--size", "64x64", "--spp", "8", "--views", "2000",
        "--frames-per-shard", "2", "--json",
    )  # fmt: skip
    process = start(*words)
    told = 0
    while told < 4:
        told = json.loads(process.stdout.readline())["acknowledged"]
    begin = time.monotonic()
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert time.monotonic() - begin < 5.0
    assert process.returncode == 1, err
    assert err.count("\n") == 1, err
    assert err.startswith("pave: error: "), err
    told = max([told, *(json.loads(line)["acknowledged"] for line in out.splitlines())])
    source = library.Source("bp:d.bp", allow_unfinished=True)
    assert told <= len(source) < 2000
    assert not source.finished
    again = pave(*words[:-1], "--resume", "--views", str(len(source) + 2), "--json")
    assert again.code == 0, again.err
    assert again.records[-1]["acknowledged"] == len(source) + 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_training_ends_soon_and_goes_on_from_that_step(place, number):
    from pave.checkpoint import list_checkpoints
    from pave.options import TrainOptions
    from pave.train import train

    small = ("--size", "12x12", "--spp", "1", "--max-depth", "3", "--views", "10")
    assert pave("dataset", "cornell", "bp:d.bp", *small).code == 0
    process = start(
        "train", "bp:d.bp", "-o", "run", "--epochs", "100000", "--filters", "4", "--json",
    )  # fmt: skip
    step = 0
    while step < 20:  # past the first epoch, which has three steps
        step = json.loads(process.stdout.readline())["step"]
    begin = time.monotonic()
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert time.monotonic() - begin < 5.0
    assert process.returncode == 1, err
    errors = [line for line in err.splitlines() if line.startswith("pave: error: ")]
    assert errors == err.splitlines()[-1:], err
    assert "Traceback" not in err
    step = max([step, *(json.loads(line)["step"] for line in out.splitlines())])
    saved = int(list_checkpoints(Path("run"))[-1].stem.rpartition("-")[2])
    assert saved >= step
    assert f"after step {saved};" in errors[0]
    assert pave("info", "run").code == 0  # the best weights so far are there and whole
    options = TrainOptions.from_json({"epochs": 100000, "filters": 4})
    again = train("bp:d.bp", "run", options, on_progress=lambda _: False, figures=False)
    assert again.resumed_from == saved


def test_interrupted_render_leaves_nothing(place):
    process = start("render", "cornell", "-o", "x.exr", "--size", "512x512", "--spp", "100000")
    maps = Path(f"/proc/{process.pid}/maps")
    while process.poll() is None and "pocl" not in maps.read_text():
        time.sleep(0.05)
    time.sleep(1.0)  # among kernels' compilation or rendering, as it comes
    begin = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert time.monotonic() - begin < 5.0
    assert process.returncode == 1, err
    assert err.splitlines()[-1].startswith("pave: error: "), err
    assert list(place.iterdir()) == []


def test_debug_shows_where(place):
    process = subprocess.run(
        [*PAVE, "render", "gone.xml", "-o", "x.exr"],
        capture_output=True,
        text=True,
        timeout=60,
        env={**environment(), "PAVE_DEBUG": "1"},
    )
    assert "Traceback" in process.stderr
    assert "InputError" in process.stderr


def test_reader_of_the_pipe_that_leaves_is_no_bug():
    process = start("doctor", "--json")
    process.stdout.close()
    err = process.stderr.read()
    process.wait(timeout=60)
    assert "Traceback" not in err
    assert "internal error" not in err
