"""Benches validate, then time: what their lines hold, and what a wrong answer or a missing peer does.

SPDX-License-Identifier: BSD-3-Clause
"""

import json
from pathlib import Path

import numpy as np
import pytest
from command import ROOT, pave

from pave.bench import common, subjects
from pave.bench.command import BENCHES
from pave.bench.meshes import as_meshes, displaced_sphere
from pave.console import Console

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


def test_missing_peer_leaves_paves_figures(tmp_path):
    (tmp_path / "mitsuba.py").write_text("raise ImportError('not here')")
    done = pave("bench", "mesh", "--peers", *QUICK, PYTHONPATH=f"{tmp_path}:{ROOT / 'python'}")
    assert done.code == 0, done.err
    assert [line for line in done.err.splitlines() if "no Mitsuba (not here): get it by" in line]
    check_schema(done.records, peer=False)


def test_wrong_peer_prints_no_number(tmp_path):
    (tmp_path / "mitsuba.py").write_text(WRONG_MITSUBA)
    done = pave("bench", "cornell", "--peers", *QUICK, PYTHONPATH=f"{tmp_path}:{ROOT / 'python'}")
    assert done.code == 1
    assert done.out == ""
    errors = [line for line in done.err.splitlines() if line.startswith("pave: error:")]
    assert len(errors) == 1
    assert "wrong answer, no number" in errors[0]


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
