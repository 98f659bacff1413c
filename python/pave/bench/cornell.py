"""How many paths a second does PAVE trace in a small scene: as it is, with all buffers, as meshes?

SPDX-License-Identifier: BSD-3-Clause

Mitsuba renders the color alone in every case, also where PAVE fills six buffers.
"""

from __future__ import annotations

from pathlib import Path

from pave.bench.common import Bench, scene_file, temporary_folder
from pave.bench.meshes import as_meshes
from pave.bench.speed import Job, measure
from pave.bench.subjects import SIX, Mitsuba

QUICK_SIZE = 16


def run(bench: Bench) -> None:
    size = QUICK_SIZE if bench.options.quick else 256
    mitsuba = Mitsuba.find(bench)
    path = scene_file("cornell")
    measure(bench, mitsuba, Job("cornell", path, size))
    measure(bench, mitsuba, Job("cornell-six", path, size, channels=SIX))
    with temporary_folder() as folder:
        measure(bench, mitsuba, Job("meshes", as_meshes(path, Path(folder)), size))
