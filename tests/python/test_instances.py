"""Ten thousand instances of a mesh of 250,000 triangles: one mesh's memory, and a picture.

SPDX-License-Identifier: BSD-3-Clause

pytest -s prints the figures of bench/RESULTS.md.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

import pave

DEVICE = os.environ.get("PAVE_DEVICE", "cpu")
SIDE = 100  # instances along each side of a square
ROWS = 251  # of quads on the sphere
WIDTH, HEIGHT, SPP = 512, 384, 4

HEAD = f"""<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="8"/></integrator>
<sensor type="perspective"><float name="fov" value="50"/>
<transform name="to_world"><lookat origin="0,14,40" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="{WIDTH}"/><integer name="height" value="{HEIGHT}"/>
<rfilter type="box"/></film></sensor>
<emitter type="constant"/>
<shape type="rectangle"><transform name="to_world"><scale value="200"/><rotate x="1" angle="-90"/>
<translate y="-0.7"/></transform></shape>
<shape type="shapegroup" id="stone"><shape type="ply">
<string name="filename" value="stone.ply"/></shape></shape>
"""


def write_bumpy_sphere(path: Path) -> int:
    """A binary PLY file; returns its triangles."""
    columns = 2 * ROWS
    theta = np.pi * np.arange(1, ROWS) / ROWS
    phi = 2 * np.pi * np.arange(columns) / columns
    theta, phi = (grid.ravel() for grid in np.meshgrid(theta, phi, indexing="ij"))
    radius = 0.6 + 0.06 * np.sin(7 * theta) * np.cos(5 * phi)
    radius += 0.01 * np.cos(61 * theta) * np.cos(67 * phi)
    around = np.sin(theta) * np.array([np.cos(phi), 0 * phi, np.sin(phi)])
    points = radius * (around + np.array([0 * theta, np.cos(theta), 0 * theta]))
    points = np.concatenate([[[0, 0.6, 0], [0, -0.6, 0]], points.T]).astype("<f4")
    row, column = (grid.ravel() for grid in np.indices((ROWS, columns)))

    def index(row, column):
        inner = 2 + (row - 1) * columns + column % columns
        return np.where(row == 0, 0, np.where(row == ROWS, 1, inner))

    a, b = index(row, column), index(row + 1, column)
    c, d = index(row + 1, column + 1), index(row, column + 1)
    triangles = np.concatenate(
        [np.stack([a, c, b], 1)[row + 1 < ROWS], np.stack([a, d, c], 1)[row > 0]]
    )
    faces = np.zeros(len(triangles), [("count", "u1"), ("vertices", "<i4", 3)])
    faces["count"], faces["vertices"] = 3, triangles
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + points.tobytes() + faces.tobytes())
    return len(faces)


def write_scene(path: Path) -> None:
    rng = np.random.default_rng(1)
    lines = [HEAD]
    for i in range(SIDE * SIDE):
        turn = rng.uniform(0, 360, 2)
        x, z = (i % SIDE - SIDE / 2) * 1.1, (i // SIDE - SIDE / 2) * 1.1
        lines.append(
            f'<shape type="instance"><ref id="stone"/><transform name="to_world">'
            f'<rotate x="1" angle="{turn[0]:.3f}"/><rotate y="1" angle="{turn[1]:.3f}"/>'
            f'<translate x="{x:.3f}" z="{z:.3f}"/></transform></shape>\n'
        )
    path.write_text("".join(lines) + "</scene>\n")


def resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def test_ten_thousand_instances_take_the_memory_of_one_mesh(tmp_path):
    triangles = write_bumpy_sphere(tmp_path / "stone.ply")
    assert triangles == 251_000
    write_scene(tmp_path / "field.xml")
    device = pave.Device(DEVICE)
    before, start = resident_mib(), time.perf_counter()
    scene = pave.load_scene(tmp_path / "field.xml")
    renderer = pave.Renderer(device, scene)
    built = time.perf_counter() - start
    grown = resident_mib() - before
    assert scene.shape_count == SIDE * SIDE + 1
    # Twice the mesh as it was read (14 MiB with its normals), and tree, corners and tables (58 MiB).
    assert grown < 256, "copies of the mesh would take 500 GiB"
    size = {"width": WIDTH, "height": HEIGHT}
    with pave.Stage(device, "mem:", channels=["color", "object"], slots=1, **size) as stage:
        frame = stage.acquire()
        renderer.render(None, frame, spp=1)  # compiles
        start, cpu = time.perf_counter(), time.process_time()
        renderer.render(None, frame, spp=SPP)
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
        objects = np.unique(frame["object"].numpy(copy=True))
        assert len(objects) > SIDE * SIDE / 4, "many of them are seen"
        assert np.isfinite(frame["color"].numpy()).all()
    assert renderer.dropped_samples == 0
    paths = WIDTH * HEIGHT * SPP * 1e-6
    print(
        f"load and build {built:.2f} s, {grown:.0f} MiB; render {paths / seconds:.2f} million paths/s, "
        f"{paths / cpu:.2f} by processor second"
    )
