"""Blender's Cycles as a peer: the same scene, handed to a process whose Python has `bpy`.

SPDX-License-Identifier: BSD-3-Clause

PAVE neither ships nor imports Blender: PAVE_BENCH_BPY names another Python, which runs
`cycles_worker.py`.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import tempfile
import xml.etree.ElementTree as ET
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

import pave
from pave.bench.common import Bench, Mean
from pave.bench.meshes import as_mesh, read_ply
from pave.errors import InputError, RunError

PYTHON = "PAVE_BENCH_BPY"
HOW_TO_GET = (
    "`python3 -m venv FOLDER && FOLDER/bin/pip install bpy==5.0.1`, "
    f"then {PYTHON}=FOLDER/bin/python"
)
WORKER = Path(__file__).with_name("cycles_worker.py")
LIMIT_S = 600.0  # one answer of the worker; a render takes seconds
UNUSED_SEED = 2**31 - 1
# Of a shape that names no material, as in Mitsuba: an emitter is black.
DEFAULT_REFLECTANCE, EMITTER_REFLECTANCE = [0.5] * 3, [0.0] * 3


class Cycles:
    """Cycles on the CPU. Make it with `Cycles.find`; it holds one process until `close`."""

    name = "Cycles"

    def __init__(self, python: str) -> None:
        self._python = python
        self._folder = tempfile.TemporaryDirectory(prefix="pave-bench-")
        self._log = Path(self._folder.name) / "log"
        self._start()
        try:
            self.label = f"cycles {self._ask({})['version']} cpu"
        except BaseException:
            self.close()
            raise

    @classmethod
    def find(cls, bench: Bench) -> Cycles | None:
        """None, with a line that says how to get it, where it is missing or was not asked for."""
        if not bench.options.peers:
            return None
        python = os.environ.get(PYTHON, "")
        try:
            if not python:
                raise RunError(f"{PYTHON} is not set")
            return cls(python)
        except (RunError, OSError) as error:
            bench.remark(f"no Cycles ({error}): get it by {HOW_TO_GET}")
            return None

    def load(self, path: Path, size: int, spp: int) -> None:
        """Hands the scene to the worker, in place of the one before."""
        record, arrays = describe(path, size)
        record["spp"] = spp
        np.savez(Path(self._folder.name) / "arrays.npz", **arrays)
        self._ask({"scene": record})
        self._ask({"seed": UNUSED_SEED})  # builds its tree, which it keeps from then on

    def render(self, _scene: None, _spp: int, seed: int = 0) -> None:
        """Returns when Cycles has the image, with the samples of `load`; `image` fetches it."""
        self._ask({"seed": seed})

    def image(self) -> np.ndarray:
        """(3, H, W), linear, of the last render."""
        self._ask({"save": "image.npy"})
        return np.load(Path(self._folder.name) / "image.npy", allow_pickle=False)

    def mean(self, scene: None, spp: int, runs: int = 4) -> Mean:
        """Of images with seeds that no round uses."""
        images = []
        for run in range(runs):
            self.render(scene, spp, 1000 + run)
            images.append(self.image())
        return Mean.of_runs(images)

    def close(self) -> None:
        """Ends the process and removes its files."""
        self._process.kill()
        self._process.communicate()
        self._answers.close()
        self._folder.cleanup()

    def _start(self) -> None:
        answers, theirs = os.pipe()
        self._answers = os.fdopen(answers)
        try:
            with self._log.open("w") as log:
                self._process = subprocess.Popen(
                    # -I: this folder's cycles.py would stand for Blender's module of that name.
                    [self._python, "-I", str(WORKER), self._folder.name, str(theirs)],
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=log,
                    text=True,
                    pass_fds=(theirs,),
                )
        finally:
            os.close(theirs)

    def _ask(self, job: dict[str, Any]) -> dict[str, Any]:
        pipe = self._process.stdin
        assert pipe is not None
        with suppress(BrokenPipeError):  # its last words say more
            pipe.write(json.dumps(job) + "\n")
            pipe.flush()
        if not select.select([self._answers], [], [], LIMIT_S)[0]:
            raise RunError(f"Cycles gave no answer within {LIMIT_S:.0f} s")
        line = self._answers.readline()
        if not line:
            words = self._log.read_text(errors="replace").split("\n")
            last = next(
                (f": {line}" for line in reversed(words) if line.strip()), " without a word"
            )
            raise RunError(f"{self._python} ended{last}")
        return json.loads(line)


def describe(path: Path, size: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A scene of the benches for the worker: what is not an array, and the arrays by name.

    Diffuse materials, rectangles, cubes and meshes of `write_ply`, black area lights; else InputError.
    """
    loaded = pave.load_scene(path, defines={"size": size})
    root = ET.parse(path).getroot()
    colours = {}
    for bsdf in root.findall("bsdf"):
        if bsdf.get("type") != "diffuse":
            raise InputError(f"{path}: the bench has no {bsdf.get('type')} for Cycles")
        colours[bsdf.get("id")] = _rgb(bsdf, "reflectance")
    shapes, arrays = [], {}
    for number, shape in enumerate(root.findall("shape")):
        reference, emitter = shape.find("ref"), shape.find("emitter")
        reflectance = DEFAULT_REFLECTANCE if emitter is None else EMITTER_REFLECTANCE
        if reference is not None:
            reflectance = colours[reference.get("id")]
        if emitter is not None and any(reflectance):
            raise InputError(f"{path}: the bench has no light that reflects for Cycles")
        radiance = None if emitter is None else _rgb(emitter, "radiance")
        shapes.append({"reflectance": reflectance, "radiance": radiance})
        points, triangles, normals = _geometry(path, shape)
        arrays[f"points{number}"], arrays[f"triangles{number}"] = points, triangles
        if normals is not None:
            arrays[f"normals{number}"] = normals
    record = {
        "size": size,
        "threads": len(os.sched_getaffinity(0)),
        "max_depth": loaded.max_depth,
        "rr_depth": loaded.rr_depth,
        "world_from_camera": loaded.view.matrix.tolist(),
        "fov": loaded.view.fov,
        "shapes": shapes,
    }
    return record, arrays


def _rgb(node: ET.Element, name: str) -> list[float]:
    found = node.find(f"rgb[@name='{name}']")
    if found is None:
        raise InputError(f"the bench wants an rgb {name} in <{node.tag}> for Cycles")
    return [float(number) for number in found.get("value", "").split(",")]


def _geometry(path: Path, shape: ET.Element) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Points in the world, triangles and normals, if there are any, of a shape."""
    name = shape.find("string[@name='filename']")
    if shape.get("type") == "ply" and name is not None:
        return read_ply(path.parent / name.get("value", ""))
    return *as_mesh(path, shape), None
