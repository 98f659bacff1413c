"""How many rays a second does PAVE trace through a mesh?

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from pave.bench.common import Bench
from pave.bench.programs import run_program


def run(bench: Bench) -> None:
    run_program(bench, "bench_rays")
