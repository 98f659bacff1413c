"""How long does a mesh of millions of triangles take to its first ray?

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from pave.bench.common import Bench
from pave.bench.programs import run_program


def run(bench: Bench) -> None:
    run_program(bench, "bench_build")
