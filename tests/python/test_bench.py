"""Benches validate, then time: what their lines hold, and what a wrong answer or a missing peer does.

SPDX-License-Identifier: BSD-3-Clause
"""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from command import ROOT, pave

from pave.bench import common, subjects
from pave.bench.command import BENCHES
from pave.bench.cycles import describe
from pave.bench.meshes import as_meshes, displaced_sphere, with_sphere
from pave.console import Console
from pave.errors import InputError

QUICK = ("--quick", "--json", "--rounds", "1")
CORNELL = ["cornell", "cornell-six", "meshes"]

# Stands for a Mitsuba whose images are grey.
WRONG_MITSUBA = """
import numpy as np
class LogLevel:
    Error = 0
Float = float
set_variant = set_log_level = lambda *_: None
load_file = lambda path, size, spp: int(size)
def render(size, spp, seed):
    return np.random.default_rng(seed).normal(0.5, 0.01, (size, size, 3))
"""

# Stands for a Python with `bpy`; its images are noise around GREY.
FAKE_CYCLES = f"""#!{sys.executable}
import json, os, sys
import numpy as np
folder, answers, size = sys.argv[3], os.fdopen(int(sys.argv[4]), "w"), 0
for line in sys.stdin:
    job = json.loads(line)
    size = job.get("scene", {{"size": size}})["size"]
    rng = np.random.default_rng(job.get("seed"))
    if "save" in job:
        np.save(os.path.join(folder, job["save"]), rng.normal(GREY, 0.01, (3, size, size)))
    print(json.dumps({{"version": "0"}}), file=answers, flush=True)
"""


@pytest.fixture
def no_mitsuba(tmp_path) -> str:
    """A PYTHONPATH."""
    (tmp_path / "mitsuba.py").write_text("raise ImportError('not here')")
    return f"{tmp_path}:{ROOT / 'python'}"


def check_schema(records, peer):
    for record in records:
        assert set(common.KEYS) <= set(record)
        assert record["value"] > 0
        assert record["n"] >= 1
        assert record["spread"] >= 0
        assert record["mean"] > 0
        assert record["mean_error"] > 0
        assert all(isinstance(record[key], str) for key in ("unit", "device", "driver", "commit"))
        theirs = [record[key] for key in ("peer", "peer_value", "ratio")]
        if peer:
            assert record["peer"].startswith("mitsuba")
            assert record["ratio"] == pytest.approx(record["value"] / record["peer_value"])
        else:
            assert theirs == [None] * 3


def test_cornell_alone():
    done = pave("bench", "cornell", *QUICK)
    assert done.code == 0, done.err
    assert [record["case"] for record in done.records] == CORNELL
    check_schema(done.records, peer=False)


def test_cornell_beside_mitsuba():
    done = pave("bench", "cornell", "--peers", *QUICK)
    assert done.code == 0, done.err
    assert [record["case"] for record in done.records] == CORNELL
    check_schema(done.records, peer=True)


def test_table():
    done = pave("bench", "mesh", "--quick", "--rounds", "1")
    assert done.code == 0, done.err
    assert "mesh-1600" in done.out
    assert "paths/s" in done.out


@pytest.mark.parametrize(
    ("python", "reason"),
    [
        (None, "PAVE_BENCH_BPY is not set"),
        ("/not/there", "No such file or directory: '/not/there'"),
        ("/bin/true", "/bin/true ended without a word"),
        (sys.executable, "ended: ModuleNotFoundError: No module named 'bpy'"),
    ],
)
def test_missing_peers_leave_paves_figures(no_mitsuba, python, reason):
    done = pave("bench", "mesh", "--peers", *QUICK, PYTHONPATH=no_mitsuba, PAVE_BENCH_BPY=python)
    assert done.code == 0, done.err
    lines = done.err.splitlines()
    assert [line for line in lines if "no Mitsuba (not here): get it by" in line]
    assert [line for line in lines if "no Cycles (" in line and f"{reason}): get it by" in line]
    check_schema(done.records, peer=False)


def test_wrong_peer_prints_no_number(tmp_path):
    (tmp_path / "mitsuba.py").write_text(WRONG_MITSUBA)
    done = pave("bench", "cornell", "--peers", *QUICK, PYTHONPATH=f"{tmp_path}:{ROOT / 'python'}")
    assert done.code == 1
    assert done.out == ""
    errors = [line for line in done.err.splitlines() if line.startswith("pave: error:")]
    assert len(errors) == 1
    assert "wrong answer, no number" in errors[0]


def fake_cycles(folder: Path, grey: float) -> str:
    program = folder / "python"
    program.write_text(FAKE_CYCLES.replace("GREY", str(grey)))
    program.chmod(0o700)
    return str(program)


def test_wrong_cycles_prints_no_number(tmp_path, no_mitsuba):
    done = pave(
        "bench", "mesh", "--peers", *QUICK, PYTHONPATH=no_mitsuba,
        PAVE_BENCH_BPY=fake_cycles(tmp_path, 0.5),
    )  # fmt: skip
    assert done.code == 1
    assert done.out == ""
    assert "PAVE and Cycles: wrong answer, no number" in done.err


@pytest.mark.cycles
@pytest.mark.parametrize("name", ["cornell", "mesh"])
def test_beside_cycles(name, no_mitsuba):
    done = pave("bench", name, "--peers", *QUICK, PYTHONPATH=no_mitsuba)
    assert done.code == 0, done.err
    for record in done.records:
        assert record["peer"].startswith("cycles "), f"{done.err}; rerun: pytest -m cycles"
        assert record["ratio"] == pytest.approx(record["value"] / record["peer_value"])


def test_cycles_gets_the_scene_that_mitsuba_reads(tmp_path: Path):
    mesh = with_sphere(ROOT / "scenes/cornell.xml", tmp_path, 40)
    record, arrays = describe(mesh, 32)
    assert [shape["radiance"] for shape in record["shapes"]] == [[18, 15, 9], *[None] * 6]
    assert record["shapes"][0]["reflectance"] == [0, 0, 0]
    assert record["shapes"][4]["reflectance"] == [0.63, 0.065, 0.05]
    assert (record["size"], record["max_depth"], record["rr_depth"]) == (32, 50, 5)
    assert np.allclose(np.array(record["world_from_camera"])[:3, 3], [0, 0, 3.9])
    assert np.allclose(arrays["points0"].mean(0), [0, 0.995, 0])  # the light, which looks down
    a, b, c = arrays["points0"][arrays["triangles0"][0]]
    assert np.cross(b - a, c - a)[1] < 0
    points, triangles, normals = displaced_sphere(40)
    assert np.array_equal(arrays["triangles6"], triangles)
    assert np.allclose(arrays["points6"], points, atol=1e-6)
    assert np.allclose(arrays["normals6"], normals, atol=1e-6)
    red = '<bsdf type="diffuse" id="red">.*?</bsdf>'
    mirror = re.sub(red, '<bsdf type="conductor" id="red" />', mesh.read_text(), flags=re.S)
    mesh.write_text(mirror)
    with pytest.raises(InputError, match="no conductor for Cycles"):
        describe(mesh, 32)


@pytest.mark.parametrize("factor", [1.2, 0.0, np.nan])
def test_wrong_render_prints_no_number(monkeypatch, capsys, factor):
    from pave.bench import mesh

    right = subjects.Pave.render
    monkeypatch.setattr(
        subjects.Pave,
        "render",
        lambda self, spp, seed=0, **options: (
            right(self, spp, seed, **options) * np.float32(factor if not options else 1)
        ),
    )
    bench = common.Bench("mesh", Console(True), common.Options(quick=True, rounds=1))
    with pytest.raises(common.WrongAnswer, match="wrong answer, no number"):
        mesh.run(bench)
    assert capsys.readouterr().out == ""


def test_missing_program_says_how_to_build_it(monkeypatch, tmp_path):
    from pave.bench import programs

    monkeypatch.setattr(programs.pave, "__file__", str(tmp_path / "python/pave/__init__.py"))
    with pytest.raises(common.RunError, match="--target bench_rays"):
        programs.find_program("bench_rays")


def test_program_lines_pass_through(monkeypatch, tmp_path, capsys):
    from pave.bench import build, programs

    program = tmp_path / "bench_build"
    line = json.dumps({"bench": "build", "case": "2M", "value": 1.5, "ratio": 2.0})
    program.write_text(f"#!/bin/sh\necho '{line}'\n")
    program.chmod(0o700)
    monkeypatch.setattr(programs, "find_program", lambda name: tmp_path / name)
    bench = common.Bench("build", Console(True), common.Options())
    build.run(bench)
    record = json.loads(capsys.readouterr().out)
    assert (record["value"], record["ratio"], record["mean"]) == (1.5, 2.0, None)
    program.write_text("#!/bin/sh\nexit 1\n")
    with pytest.raises(common.RunError, match="ended with 1"):
        build.run(bench)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["equal-time", "dataset", "startup"])
def test_the_others(name):
    done = pave("bench", name, *QUICK)
    assert done.code == 0, done.err
    for record in done.records:
        assert set(common.KEYS) <= set(record)
        assert record["value"] > 0
        assert record["mean"] > 0
        assert record["peer"] is None


def test_usage():
    assert pave("bench", "nothing").code == 2
    assert pave("bench", "mesh", "--rounds", "0").code == 2
    assert set(BENCHES) == {
        "cornell", "mesh", "equal-time", "dataset", "startup", "rays", "build",
    }  # fmt: skip


def test_meshes_have_the_shapes_triangles(tmp_path: Path):
    text = as_meshes(ROOT / "scenes/cornell.xml", tmp_path).read_text()
    assert text.count('type="ply"') == 9
    assert "cube" not in text.replace("<!--", "")
    counts = [path.read_bytes().split(b"element face ")[1] for path in tmp_path.glob("*.ply")]
    assert sorted(int(count.split()[0]) for count in counts) == [2] * 6 + [12] * 3
    points, triangles, normals = displaced_sphere(40)
    assert len(triangles) == 1600
    outwards = np.einsum("ij,ij->i", normals, points - points.mean(0))
    assert np.all(outwards > 0)


def test_means_within_four_deviations_agree():
    one = common.Mean(np.array([1.0, 1.0]), np.array([0.01, 0.01]))
    one.check(common.Mean(np.array([1.05, 0.95]), np.array([0.01, 0.01])), "near")
    with pytest.raises(common.WrongAnswer):
        one.check(common.Mean(np.array([1.06, 1.0]), np.array([0.01, 0.01])), "far")
    assert common.spread([1.0, 2.0, 3.0]) == pytest.approx(0.5)
