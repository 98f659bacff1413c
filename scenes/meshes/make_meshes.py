"""Writes the meshes of this folder: torus.ply (binary, with normals) and rock.obj (no normals).

SPDX-License-Identifier: BSD-3-Clause
"""

import math
import struct
from pathlib import Path

FOLDER = Path(__file__).parent


def write_torus(path: Path, around: int = 40, across: int = 20, major: float = 1.0) -> None:
    """A ring about the y axis with exact normals; its tube is 0.4 thick."""
    minor = 0.4 * major
    vertices, triangles = [], []
    for i in range(around):
        u = 2 * math.pi * i / around
        for j in range(across):
            v = 2 * math.pi * j / across
            normal = (math.cos(v) * math.cos(u), math.sin(v), -math.cos(v) * math.sin(u))
            centre = (major * math.cos(u), 0.0, -major * math.sin(u))
            position = [c + minor * n for c, n in zip(centre, normal, strict=True)]
            vertices.append(struct.pack("<6f", *position, *normal))
            a, b = i * across + j, ((i + 1) % around) * across + j
            c = ((i + 1) % around) * across + (j + 1) % across
            d = i * across + (j + 1) % across
            triangles += [struct.pack("<B3i", 3, a, b, c), struct.pack("<B3i", 3, a, c, d)]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    header += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    header += ["end_header", ""]
    path.write_bytes("\n".join(header).encode() + b"".join(vertices) + b"".join(triangles))


def icosphere(levels: int) -> tuple[list, list]:
    g = (1 + math.sqrt(5)) / 2
    vertices = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    vertices += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4)]
    faces += [(11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8)]
    faces += [(3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    vertices = [tuple(x / math.hypot(*v) for x in v) for v in vertices]
    for _ in range(levels):
        middles, finer = {}, []

        def middle(a: int, b: int, middles: dict = middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                point = [p + q for p, q in zip(vertices[a], vertices[b], strict=True)]
                vertices.append(tuple(x / math.hypot(*point) for x in point))
                middles[key] = len(vertices) - 1
            return middles[key]

        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = finer
    return vertices, faces


def write_rock(path: Path) -> None:
    """A lumpy ball of radius about 1."""
    vertices, faces = icosphere(2)
    lines = ["# a lumpy ball without normals; written by make_meshes.py"]
    for x, y, z in vertices:
        r = 1 + 0.12 * math.sin(3 * x + 1) * math.cos(4 * y) + 0.08 * math.sin(5 * z + 2 * x)
        lines.append(f"v {r * x:.6f} {r * y:.6f} {r * z:.6f}")
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    write_torus(FOLDER / "torus.ply")
    write_rock(FOLDER / "rock.obj")
