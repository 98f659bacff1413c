"""How many paths a second does PAVE trace in the box with a mesh of 250,000 triangles?

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from pathlib import Path

from pave.bench.common import Bench, scene_file, temporary_folder
from pave.bench.meshes import with_sphere
from pave.bench.speed import Job, found_peers, measure


def run(bench: Bench) -> None:
    size, segments = (16, 40) if bench.options.quick else (256, 500)
    with found_peers(bench) as peers, temporary_folder() as folder:
        path = with_sphere(scene_file("cornell"), Path(folder), segments)
        measure(bench, peers, Job(f"mesh-{segments * segments}", path, size))
