"""How long does a small render take as a process: with an empty kernel cache, and afterwards?

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

import pave
from pave.bench.common import Bench, Figure, Mean, WrongAnswer, temporary_folder, timed
from pave.bench.subjects import SIX, Pave
from pave.errors import RunError

SIZE, SPP = 64, 4
FIRST_RUNS = 3  # each compiles every kernel
LIMIT_S = 300


def run(bench: Bench) -> None:
    bench.note("validating")
    own = Pave(bench.device, "cornell", SIZE, SIX)
    expected = own.render(SPP).copy()
    mean = Mean.of_variance(expected, own.frame["variance"].numpy())
    first, later = [], []
    for number in range(bench.rounds(FIRST_RUNS)):
        bench.note(f"empty kernel cache, run {number + 1}")
        with temporary_folder() as folder:
            first.append(timed(lambda folder=folder: render(bench, Path(folder), expected)))
            count = bench.rounds() if number == 0 else 0
            later += [
                timed(lambda folder=folder: render(bench, Path(folder), expected))
                for _ in range(count)
            ]
    for case, seconds in (("first", first), ("later", later)):
        bench.report(Figure(case, "wall_seconds", "s", seconds, higher_is_better=False, mean=mean))


def render(bench: Bench, folder: Path, expected: np.ndarray) -> None:
    """`pave render` with its kernel cache in `folder`. Raises WrongAnswer for other pixels."""
    output = folder / "x.exr"
    words = ["render", "cornell", "-o", str(output), "--size", f"{SIZE}x{SIZE}", "--spp", str(SPP)]
    package = str(Path(pave.__file__).resolve().parents[1])
    paths = [package, os.environ.get("PYTHONPATH", "")]
    elsewhere = ("PAVE_CACHE_DIR", "PAVE_NO_CACHE", "POCL_CACHE_DIR")
    environment = {
        **{key: value for key, value in os.environ.items() if key not in elsewhere},
        "XDG_CACHE_HOME": str(folder),
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
    }
    done = subprocess.run(
        [sys.executable, "-m", "pave", *words, "--device", bench.device.profile.id],
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
    )
    if done.returncode != 0:
        raise RunError(f"pave render ended with {done.returncode}: {done.stderr.strip()[-300:]}")
    if not np.array_equal(pave.read_exr(output)["color"].numpy(), expected):
        raise WrongAnswer("startup: wrong answer, no number: the process renders other pixels")
