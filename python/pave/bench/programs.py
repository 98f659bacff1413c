"""Benches that are C++ programs of the checkout: run as a process each, their lines passed through.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pave
from pave.bench.common import Bench
from pave.errors import RunError


def find_program(name: str) -> Path:
    """Of the build folder of the checkout that this package lies in. Raises RunError that says how to build it."""
    root = Path(pave.__file__).resolve().parents[2]
    for path in (root / "build/bench" / name, root / "build" / name):
        if path.is_file():
            return path
    raise RunError(
        f"{name} is not built: in a checkout, `apt install libembree-dev`, then "
        f"`cmake -S . -B build && cmake --build build --target {name}`"
    )


def run_program(bench: Bench, name: str) -> None:
    """Ends with the program's own reason if it fails; it is stopped with this process."""
    options = bench.options
    command = [str(find_program(name))]
    command += ["--rounds", str(options.rounds)] if options.rounds else []
    command += ["--peers"] if options.peers else []
    command += ["--quick"] if options.quick else []
    command += ["--device", options.device] if options.device else []
    bench.note(f"{name} runs")
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            for line in process.stdout or ():
                bench.add(json.loads(line))
                bench.note(f"{name}: {len(bench.records)} lines")
        except BaseException:
            process.terminate()
            raise
    if process.returncode != 0:
        raise RunError(f"{name} ended with {process.returncode}; its reason is above")
