"""How many paths a second does PAVE trace in a small scene: as it is, with all buffers, as meshes?

SPDX-License-Identifier: BSD-3-Clause

Peers render the color alone in every case, also where PAVE fills six buffers.
"""

from __future__ import annotations

from pathlib import Path

from pave.bench.common import Bench, scene_file, temporary_folder
from pave.bench.meshes import as_meshes
from pave.bench.speed import Job, found_peers, measure
from pave.bench.subjects import SIX

QUICK_SIZE = 16


def run(bench: Bench) -> None:
    size = QUICK_SIZE if bench.options.quick else 256
    path = scene_file("cornell")
    with found_peers(bench) as peers, temporary_folder() as folder:
        measure(bench, peers, Job("cornell", path, size))
        measure(bench, peers, Job("cornell-six", path, size, channels=SIX))
        measure(bench, peers, Job("meshes", as_meshes(path, Path(folder)), size))
