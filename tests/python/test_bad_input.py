"""Bad input ends with the documented exit code, one line that says what is wrong, and nothing half-written.

SPDX-License-Identifier: BSD-3-Clause
"""

import json
import os
import shutil
import subprocess

import pytest
from command import ROOT, pave

import pave as library
from pave.data import split_indices
from pave.files import verify_manifest

RUN, USAGE, INPUT, DEVICE = 1, 2, 3, 4
TINY = ("--size", "8x8", "--spp", "1", "--max-depth", "3")
RENDER = ("-o", "x.exr", *TINY)
DATASET = (
    "--views",
    "6",
    "--size",
    "12x12",
    "--spp",
    "1",
    "--max-depth",
    "3",
    "--frames-per-shard",
    "2",
)

SCENE = """<scene version="3.0.0">
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="{eye}" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
      <rfilter type="box"/></film>
  </sensor>
  <shape type="rectangle">
    <transform name="to_world"><scale x="{scale}" y="1"/></transform>
    <emitter type="area"><rgb name="radiance" value="1, 1, 1"/></emitter>
  </shape>
  {more}
</scene>
"""


def scene(more="", eye="0, 0, 4", scale="1"):
    return SCENE.format(more=more, eye=eye, scale=scale)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty folder that commands run in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A small data set as BP and as EXR, never changed."""
    folder = tmp_path_factory.mktemp("data")
    for uri in ("bp:good.bp", "exr:good.exr"):
        done = pave("dataset", "cornell", uri, *DATASET, cwd=folder)
        assert done.code == 0, done.err
    return folder


def files(folder):
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.is_symlink()
    }


def check(outcome, code, *parts):
    """Exit code, and one line on stderr with each of `parts` in it. Progress notes may come before that line."""
    lines = outcome.err.splitlines()
    errors = [line for line in lines if line.startswith("pave: error: ")]
    assert outcome.code == code, outcome.err
    assert len(errors) == 1, outcome.err
    assert lines[-1] == errors[0], outcome.err
    assert "Traceback" not in outcome.err
    for part in parts:
        assert part in errors[0], errors[0]


def check_nothing(outcome, code, folder, before, *parts):
    """The same, and the folder is as it was."""
    check(outcome, code, *parts)
    assert files(folder) == before


# The device -----------------------------------------------------------------------------------------------------------


def test_no_opencl_platform(place):
    outcome = pave("render", "cornell", *RENDER, OCL_ICD_VENDORS="/nonexistent")
    check_nothing(outcome, DEVICE, place, {}, "pocl-opencl-icd")


@pytest.mark.parametrize("command", [("render", "cornell", *RENDER), ("demo", "out", "--quick")])
def test_unknown_device(place, command):
    outcome = pave(*command, "--device", "abacus")
    check_nothing(outcome, DEVICE, place, {}, "abacus")
    assert list(place.iterdir()) == []


def test_doctor_without_platform():
    outcome = pave("doctor", "--json", OCL_ICD_VENDORS="/nonexistent")
    assert outcome.code == DEVICE
    broken = [record for record in outcome.records if not record["ok"]]
    assert broken
    assert "pocl-opencl-icd" in broken[0]["fix"]


def test_doctor_offers_no_package_for_a_device_that_there_is_not():
    outcome = pave("doctor", "--json", "--device", "abacus")
    assert outcome.code == DEVICE
    (broken,) = (record for record in outcome.records if not record["ok"])
    assert "abacus" in broken["detail"]
    assert not broken["fix"]


# Options --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (("render", "cornell", "-o", "x.exr", "--size", "0x8"), "0"),
        (("render", "cornell", "-o", "x.exr", "--size", "99999x99999"), "99999"),
        (("render", "cornell", "-o", "x.exr", "--size", "wide"), "--size wide"),
        (("render", "cornell", *RENDER, "--spp", "0"), "0"),
        (("render", "cornell", *RENDER, "--spp", "-3"), "-3"),
        (("render", "cornell", *RENDER, "--spp", "99999999"), "99999999"),
        (("render", "cornell", *RENDER, "--max-depth", "-1"), "-1"),
        (("render", "cornell", *RENDER, "--channels", "color,smell"), "smell"),
        (("render", "cornell", *RENDER, "--channels", ""), "channel"),
        (("render", "cornell", *RENDER, "--names", "klingon"), "klingon"),
        (("render", "cornell", "-o", "x.jpg", *TINY), ".jpg"),
        (("render", "cornell", "-o", "x.png", *TINY, "--channels", "depth"), "color"),
        (("render", "cornell", *RENDER, "--seed", "-1"), "-1"),
        (("render", "cornell", *RENDER, "-D", "size"), "NAME=VALUE"),
        (("render", "cornell", *RENDER, "--frobnicate"), "--frobnicate"),
        (("render", "cornell"), "--output"),
        (("frobnicate",), "frobnicate"),
        (("dataset", "cornell", "../evil", *DATASET), "../evil"),
        (("dataset", "cornell", "ftp:evil", *DATASET), "ftp:evil"),
        (("dataset", "cornell", "bp:", *DATASET), "bp:"),
        (("dataset", "cornell", "bp:x.bp", *DATASET, "--views", "0"), "0"),
        (("dataset", "cornell", "bp:x.bp", *DATASET, "--seed", "-1"), "-1"),
        (("dataset", "cornell", "bp:x.bp", *DATASET, "--slots", "0"), "0"),
        (("dataset", "cornell", "bp:x.bp", *DATASET, "--frames-per-shard", "0"), "0"),
        (("dataset", "cornell", "bp:x.bp", *DATASET, "--channels", "smell"), "smell"),
        (("info", "nowhere"), "nowhere"),
        (("demo", "--quick", "--full"), "--quick"),
        (("demo", "out", "--quick", "--seed", "-1"), "seed -1"),
        (("demo", "out", "--quick", "--seed", str(2**64)), "seed"),
    ],
)
def test_usage(place, arguments, part):
    check_nothing(pave(*arguments), USAGE, place, {}, part)


@pytest.mark.parametrize("name", ["a/b", "../up", ".hidden", "", "x" * 129, "nul\0l"])
def test_data_set_name_with_a_path_in_it(place, name):
    if name:
        with pytest.raises(library.UsageError):
            library.Stage(None, f"mem:{name}", width=8, height=8)
    with pytest.raises(library.UsageError):
        library.Stage(None, "mem:ok", width=8, height=8, channels=[(name, 1)])
    assert files(place) == {}


# Scenes ---------------------------------------------------------------------------------------------------------------

NAN_OBJ = "v 0 0 0\nv nan 1 0\nv 1 0 0\nf 1 2 3\n"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (scene('<phasefunction type="hg"/>'), ("bad.xml:11", "phasefunction")),
        (scene('<shape type="teapot"/>'), ("bad.xml:11", "teapot")),
        (
            scene('<shape type="obj"><string name="filename" value="gone.obj"/></shape>'),
            ("bad.xml", "gone.obj"),
        ),
        (
            scene('<shape type="obj"><string name="filename" value="nan.obj"/></shape>'),
            ("nan.obj", "2"),
        ),
        (scene(scale="0"), ("bad.xml:8",)),
        (scene(eye="0, 0, 0"), ("bad.xml:3",)),
        (scene()[:200], ("bad.xml",)),
        ("", ("bad.xml",)),
        ("\x00\x01binary", ("bad.xml",)),
    ],
)
def test_broken_scene(place, text, parts):
    (place / "bad.xml").write_text(text)
    (place / "nan.obj").write_text(NAN_OBJ)
    check_nothing(pave("render", "bad.xml", *RENDER), INPUT, place, files(place), *parts)


def test_missing_scene(place):
    check_nothing(pave("render", "gone.xml", *RENDER), INPUT, place, {}, "gone.xml")
    check_nothing(pave("render", "corneII", *RENDER), INPUT, place, {}, "cornell")


def test_unsupported_nodes_can_be_ignored(place):
    (place / "odd.xml").write_text(scene('<phasefunction type="hg"/>'))
    outcome = pave("render", "odd.xml", *RENDER, "--ignore-unsupported")
    assert outcome.code == 0, outcome.err
    assert "odd.xml:11" in outcome.err


def test_camera_inside_a_wall_is_allowed(place):
    (place / "in.xml").write_text(scene('<shape type="cube"/>', eye="0.5, 0.5, 0.5"))
    outcome = pave("render", "in.xml", *RENDER)
    assert outcome.code == 0, outcome.err
    assert (place / "x.exr").exists()


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[", "JSON"),
        ("[]", "at least one"),
        ('[{"eye": [0, 0, 4]}]', "target"),
        ('[{"eye": [0, 0, 4], "target": [0, 0, 4]}]', "view 0"),
        ('[{"eye": [0, 0], "target": [0, 0, 0]}]', "view 0"),
        ('[{"eye": [0, 0, 4], "target": [0, 0, 0], "fov": 200}]', "200"),
        ('[{"eye": [0, 0, 4], "target": [0, 0, 0], "zoom": 2}]', "zoom"),
        ("[1]", "view 0"),
    ],
)
def test_broken_views_file(place, text, part):
    (place / "views.json").write_text(text)
    outcome = pave("dataset", "cornell", "bp:x.bp", *TINY, "--views-file", "views.json")
    check_nothing(outcome, INPUT, place, files(place), "views.json", part)


# Stored data ----------------------------------------------------------------------------------------------------------


def flip(path, position):
    content = bytearray(path.read_bytes())
    content[position] ^= 0x10
    path.write_bytes(content)


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def stored_files(folder):
    return sorted(
        path
        for path in folder.rglob("*")
        if path.is_file() and path.name not in (".lock", "timings.jsonl") and path.stat().st_size
    )


def read_all(uri):
    source = library.Source(uri)
    for position in range(len(source)):
        source.read(position)
    return len(source)


@pytest.mark.parametrize("uri", ["bp:good.bp", "exr:good.exr"])
@pytest.mark.parametrize("damage", ["flip", "cut", "gone"])
def test_damaged_data_set(data, tmp_path, uri, damage):
    name = uri.partition(":")[2]
    shutil.copytree(data / name, tmp_path / name)
    for path in stored_files(tmp_path / name):
        before = path.read_bytes()
        if damage == "flip":
            flip(path, len(before) // 2)
        elif damage == "cut":
            cut(path)
        else:
            path.unlink()
        with pytest.raises(library.InputError) as caught:
            read_all(f"{uri.partition(':')[0]}:{tmp_path / name}")
        assert "\n" not in str(caught.value)
        path.write_bytes(before)
    # Undamaged again, so it was the damage that was found.
    assert read_all(f"{uri.partition(':')[0]}:{tmp_path / name}") == 6


@pytest.mark.parametrize("name", ["good.bp", "good.exr"])
def test_damaged_data_set_by_command(data, place, name):
    shutil.copytree(data / name, place / name)
    path = max(stored_files(place / name), key=lambda path: path.stat().st_size)
    if name == "good.exr":  # a frame that training reads
        path = place / name / f"frame-{split_indices(6)[0][0]:08d}.exr"
    flip(path, path.stat().st_size // 2)
    uri = f"{name[5:]}:{name}"
    before = files(place)
    check_nothing(pave("info", uri), INPUT, place, before, path.name)
    check(pave("train", uri, "-o", "run", "--epochs", "1"), INPUT, path.name)


def test_damaged_manifest(data, place):
    shutil.copytree(data / "good.bp", place / "good.bp")
    flip(place / "good.bp" / "manifest.jsonl", 100)
    check_nothing(pave("info", "bp:good.bp"), INPUT, place, files(place), "manifest.jsonl")


def test_unfinished_data_set_is_no_training_data(data, place):
    shutil.copytree(data / "good.bp", place / "good.bp")
    manifest = place / "good.bp" / "manifest.jsonl"
    manifest.write_bytes(manifest.read_bytes()[:-20])  # as after a kill in the last write
    check(pave("train", "bp:good.bp", "-o", "run", "--epochs", "1"), INPUT, "good.bp")
    outcome = pave("info", "bp:good.bp", "--json")
    assert outcome.code == 0, outcome.err
    assert outcome.records[0]["finished"] is False


def test_foreign_folder_is_no_data_set(place):
    (place / "x.bp").mkdir()
    (place / "x.bp" / "data.0").write_bytes(b"x" * 100)
    check_nothing(pave("info", "bp:x.bp"), INPUT, place, files(place), "x.bp")
    check_nothing(pave("info", "bp:gone.bp"), INPUT, place, files(place), "gone.bp")


def test_data_set_that_exists_is_not_overwritten(data, place):
    shutil.copytree(data / "good.bp", place / "good.bp")
    outcome = pave("dataset", "cornell", "bp:good.bp", *DATASET)
    check_nothing(outcome, USAGE, place, files(place), "good.bp")
    outcome = pave("dataset", "cornell", "bp:good.bp", *DATASET, "--size", "16x16", "--resume")
    check_nothing(outcome, USAGE, place, files(place), "good.bp")


def test_wrong_channel_for_training(data, place):
    outcome = pave(
        "train", f"bp:{data / 'good.bp'}", "-o", "run", "--epochs", "1", "--inputs", "smell"
    )
    check(outcome, USAGE, "smell")


def test_usage_of_train(data, place):
    outcome = pave("train", f"bp:{data / 'good.bp'}", "-o", "run", "--best", "beauty")
    check_nothing(outcome, USAGE, place, {}, "beauty", "psnr, ssim, l1")
    assert list(place.iterdir()) == []


def test_training_into_a_folder_of_something_else(data, place):
    (place / "letters").mkdir()
    (place / "letters" / "a.txt").write_text("dear")
    outcome = pave("train", f"bp:{data / 'good.bp'}", "-o", "letters")
    check_nothing(outcome, USAGE, place, files(place), "letters")


@pytest.mark.parametrize("text", ["{", "", "[]", "{}", "\x00"])
def test_damaged_demo_folder(place, text):
    (place / "out").mkdir()
    (place / "out" / "demo.json").write_text(text)
    check_nothing(pave("demo", "out", "--quick"), INPUT, place, files(place), "demo.json")


def test_evaluation_on_a_set_of_another_size(data, place):
    uri = f"bp:{data / 'good.bp'}"
    trained = pave("train", uri, "-o", "run", "--epochs", "1", "--filters", "4")
    assert trained.code == 0, trained.err
    size = ("--size", "12x12", "--spp", "1", "--max-depth", "3")
    assert pave("dataset", "cornell", "bp:more.bp", "--views", "10", *size).code == 0
    outcome = pave("evaluate", "run", "bp:more.bp")
    check_nothing(outcome, USAGE, place, files(place), "training images", "--novel bp:more.bp")
    outcome = pave("evaluate", "run", uri, "--novel", "bp:more.bp", "--json")
    assert outcome.code == 0, outcome.err
    counts = [record["images"] for record in outcome.records if record.get("stage") == "evaluate"]
    assert counts == list(range(1, 4 + 6 + 10 + 1))  # the ambient fit, every split, the other set
    assert outcome.records[-1]["splits"]["novel"]["images"] == 10


def test_images_too_small_for_training(place):
    small = ("--size", "10x12", "--spp", "1", "--max-depth", "3")
    assert pave("dataset", "cornell", "bp:small.bp", "--views", "6", *small).code == 0
    check(pave("train", "bp:small.bp", "-o", "run"), USAGE, "10x12 pixels are too small")


# Weights --------------------------------------------------------------------------------------------------------------


def tiny_run(place):
    shutil.copytree(ROOT / "tests" / "data" / "tiny-run", place / "run")
    return place / "run"


@pytest.mark.parametrize("name", ["generator.safetensors", "generator.json", "run-manifest.json"])
@pytest.mark.parametrize("damage", [cut, lambda path: flip(path, path.stat().st_size // 2)])
def test_damaged_weights(place, name, damage):
    damage(tiny_run(place) / name)
    outcome = pave("infer", "run", "cornell", "-o", "x.exr", "--size", "16x16", "--spp", "1")
    check_nothing(outcome, INPUT, place, files(place), name)


def rewrite(run, **changes):
    """Changes the graph and makes the checksums right again: a foreign file, not a damaged one."""
    path = run / "generator.json"
    text = json.dumps({**json.loads(path.read_text()), **changes}).encode()
    path.write_bytes(text)
    manifest = run / "run-manifest.json"
    record = json.loads(manifest.read_text())
    record["xxh3_128"]["generator.json"] = library.hash_bytes(text)
    manifest.write_text(json.dumps(record))


@pytest.mark.parametrize(
    "changes",
    [{"version": 2}, {"format": "onnx"}, {"nodes": []}, {"result": "nowhere"}, {"inputs": []}],
)
def test_weights_of_another_schema(place, changes):
    rewrite(tiny_run(place), **changes)
    outcome = pave("infer", "run", "cornell", "-o", "x.exr", "--size", "16x16", "--spp", "1")
    check_nothing(outcome, INPUT, place, files(place), "generator.json")


def test_a_run_without_a_manifest_is_refused(place):
    (tiny_run(place) / "run-manifest.json").unlink()
    outcome = pave("infer", "run", "cornell", "-o", "x.exr", "--size", "16x16", "--spp", "1")
    check_nothing(outcome, INPUT, place, files(place), "run-manifest.json")


def test_a_deeply_nested_manifest_is_refused(place):
    """Parsers and copies of JSON recurse: neither the library nor the package may fall over it."""
    run = tiny_run(place)
    deep = '{"format": "pave-run", "version": 1, "xxh3_128": %s}' % ("[" * 200_000 + "]" * 200_000)
    (run / "run-manifest.json").write_text(deep)
    with pytest.raises(library.InputError, match=r"run-manifest\.json"):
        verify_manifest(run, ["generator.json"])
    outcome = pave("infer", "run", "cornell", "-o", "x.exr", "--size", "16x16", "--spp", "1")
    check_nothing(outcome, INPUT, place, files(place), "run-manifest.json")


def test_no_weights(place):
    (place / "run").mkdir()
    outcome = pave("infer", "run", "cornell", "-o", "x.exr", "--size", "16x16", "--spp", "1")
    check_nothing(outcome, INPUT, place, {}, "run")


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (("--size", "0x8"), "0x8"),
        (("--size", "8x0"), "8x0"),
        (("--size", "16x16", "--spp", "0"), "spp 0"),
        (("--size", "16x16", "--seed", "-1"), "seed -1"),
        (("--size", "10x16", "--compare"), "10x16 pixels are too small"),
    ],
)
def test_usage_of_infer(place, arguments, part):
    tiny_run(place)
    outcome = pave("infer", "run", "cornell", "-o", "x.exr", *arguments)
    check_nothing(outcome, USAGE, place, files(place), part)


# Places to write ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ("render", "cornell", "-o", "file/x.exr", *TINY),
        ("render", "cornell", "-o", "/proc/x.png", *TINY),
        ("render", "cornell", "-o", "gone/x.exr", *TINY),
        ("dataset", "cornell", "bp:file/x.bp", *DATASET),
        ("dataset", "cornell", "exr:/proc/x", *DATASET),
        ("demo", "file/demo", "--quick"),
    ],
)
def test_output_cannot_be_written(place, arguments):
    (place / "file").write_text("no folder")
    expected = USAGE if "bp:file/x.bp" in arguments else RUN  # a name that is no folder's
    check_nothing(pave(*arguments), expected, place, files(place))


@pytest.fixture(scope="module")
def full_disk(tmp_path_factory):
    """Environment of a command for which the folder `folder` lies on a disk of `byte_size` bytes."""
    library_path = tmp_path_factory.mktemp("shim") / "full_disk.so"
    source = ROOT / "tests" / "python" / "full_disk.c"
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-O1", "-o", library_path, source, "-ldl"],
        check=True,
        timeout=60,
    )

    def settings(folder, byte_size):
        return {
            "LD_PRELOAD": str(library_path),
            "PAVE_TEST_FULL_FOLDER": str(folder.resolve()),
            "PAVE_TEST_FULL_BYTES": str(byte_size),
        }

    return settings


@pytest.mark.parametrize("uri", ["bp:full.bp", "exr:full.exr"])
@pytest.mark.parametrize("byte_size", [0, 3000, 300_000])
def test_disk_full_keeps_what_was_acknowledged(place, full_disk, uri, byte_size):
    kind, name = uri.split(":")
    # A frame has 16 planes of 16 KiB, so the largest of these disks is full in the second shard.
    arguments = (
        "dataset", "cornell", uri, "--size", "64x64", "--spp", "1", "--max-depth", "3",
        "--views", "4", "--frames-per-shard", "1", "--json",
    )  # fmt: skip
    outcome = pave(*arguments, **full_disk(place, byte_size))
    check(outcome, RUN, "No space left on device")
    told = max([record.get("acknowledged", 0) for record in outcome.records] or [0])
    if (place / name / "manifest.jsonl").exists():
        source = library.Source(f"{kind}:{place / name}", allow_unfinished=True)
        assert told <= len(source) < 4
        for position in range(len(source)):
            source.read(position)
    else:
        assert told == 0
    again = pave(*arguments, "--resume")
    assert again.code == 0, again.err
    assert again.records[-1]["acknowledged"] == 4


@pytest.mark.parametrize("name", ["x.exr", "x.png"])
def test_disk_full_leaves_no_image(place, full_disk, name):
    outcome = pave("render", "cornell", "-o", name, *TINY, **full_disk(place, 100))
    check_nothing(outcome, RUN, place, {}, name)


def test_damaged_kernel_cache_is_no_trouble(place):
    cache = place / "cache"
    assert pave("render", "cornell", *RENDER, PAVE_CACHE_DIR=str(cache)).code == 0
    entries = [path for path in cache.rglob("*") if path.is_file() and path.stat().st_size]
    assert entries
    for path in entries:
        path.write_bytes(os.urandom(100))
    outcome = pave("render", "cornell", *RENDER, PAVE_CACHE_DIR=str(cache))
    assert outcome.code == 0, outcome.err
