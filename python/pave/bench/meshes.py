"""Scene files that benches make out of PAVE's own: shapes as triangle meshes, a large mesh in the box.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from pave.errors import InputError

RECTANGLE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])  # of a PLY file


def write_ply(
    path: Path, points: np.ndarray, triangles: np.ndarray, normals: np.ndarray | None = None
) -> None:
    """A binary PLY file of (V, 3) points, with (V, 3) normals if given, and (T, 3) triangles."""
    names = ["x", "y", "z"] + (["nx", "ny", "nz"] if normals is not None else [])
    columns = points if normals is None else np.hstack([points, normals])
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    faces = np.empty(len(triangles), dtype=FACE)
    faces["count"], faces["corners"] = 3, triangles
    with path.open("wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode())
        file.write(columns.astype("<f4").tobytes() + faces.tobytes())


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Points, triangles, normals of a file that write_ply wrote."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    names = re.findall(rb"property float (\w+)", header)
    vertices, faces = (int(n) for n in re.findall(rb"element \w+ (\d+)", header))
    columns = np.frombuffer(body, "<f4", vertices * len(names)).reshape(vertices, len(names))
    rows = np.frombuffer(body, FACE, faces, columns.nbytes)
    return columns[:, :3], rows["corners"], columns[:, 3:] if len(names) > 3 else None


def _axis_rotation(attributes: dict[str, str]) -> np.ndarray:
    axis = np.array([float(attributes.get(name, 0)) for name in "xyz"])
    x, y, z = axis / np.linalg.norm(axis)
    angle = np.radians(float(attributes["angle"]))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def to_world(shape: ET.Element) -> np.ndarray:
    """The 4x4 matrix of a shape's scalings, rotations and translations, the first applied first."""
    matrix = np.eye(4)
    for step in shape.findall("transform/*"):
        here = np.eye(4)
        if step.tag == "scale":
            here[:3, :3] = np.diag([float(step.get(name, 1)) for name in "xyz"])
        elif step.tag == "rotate":
            here[:3, :3] = _axis_rotation(step.attrib)
        elif step.tag == "translate":
            here[:3, 3] = [float(step.get(name, 0)) for name in "xyz"]
        else:
            raise InputError(f"the bench cannot make a mesh of a shape with <{step.tag}>")
        matrix = here @ matrix
    return matrix


def cube() -> tuple[np.ndarray, np.ndarray]:
    """[-1, 1]^3: six rectangles, which share no vertices, looking outwards."""
    points, triangles = [], []
    for axis in range(3):
        for sign in (-1, 1):
            face = np.roll(RECTANGLE + np.array([0, 0, 1]), axis + 1, axis=1)
            triangles.append(QUAD + 4 * len(points))
            points.append(face if sign > 0 else -face[::-1])
    return np.concatenate(points), np.concatenate(triangles)


def as_mesh(path: Path, shape: ET.Element) -> tuple[np.ndarray, np.ndarray]:
    """A rectangle's or cube's points in the world, and triangles. Raises InputError for others."""
    if shape.get("type") not in ("cube", "rectangle"):
        raise InputError(f"{path}: the bench makes no mesh of a {shape.get('type')}")
    points, triangles = cube() if shape.get("type") == "cube" else (RECTANGLE, QUAD)
    matrix = to_world(shape)
    return points @ matrix[:3, :3].T + matrix[:3, 3], triangles


def as_meshes(path: Path, folder: Path) -> Path:
    """The scene with every rectangle (2 triangles) and cube (12) as a PLY file. Returns its file."""
    tree = ET.parse(path)
    for number, shape in enumerate(tree.getroot().iter("shape")):
        name = f"shape{number}.ply"
        write_ply(folder / name, *as_mesh(path, shape))
        for transform in shape.findall("transform"):
            shape.remove(transform)
        make_ply_shape(shape, name)
        ET.SubElement(shape, "boolean", name="face_normals", value="true")
    return _written(tree, folder / "meshes.xml")


def make_ply_shape(shape: ET.Element, file_name: str) -> None:
    shape.set("type", "ply")
    ET.SubElement(shape, "string", name="filename", value=file_name)


def _written(tree: ET.ElementTree, path: Path) -> Path:
    tree.write(path, encoding="utf-8", xml_declaration=True)
    return path


def displaced_sphere(segments: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A bumpy sphere of segments^2 triangles, counted as 2 s (s / 2): points, triangles, normals."""
    rings = segments // 2 + 1
    theta = np.pi * (np.arange(rings - 1) + 1) / rings
    phi = 2 * np.pi * np.arange(segments) / segments
    theta, phi = (grid.ravel() for grid in np.meshgrid(theta, phi, indexing="ij"))
    directions = np.stack(
        [np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], 1
    )
    directions = np.vstack([[0, 1, 0], directions, [0, -1, 0]])
    x, y, z = directions.T
    bumps = np.sin(13 * x + 1) * np.sin(11 * y + 2) * np.sin(12 * z)
    points = 0.55 * directions * (1 + 0.12 * bumps)[:, None] + [0.05, -0.35, -0.1]
    return points, *_sphere_surface(points, rings, segments)


def _sphere_surface(points: np.ndarray, rings: int, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles, looking outwards, and the normals of the vertices, weighted by area."""
    around = np.arange(segments)
    ahead = (around + 1) % segments
    last = len(points) - 1
    triangles = [np.stack([np.zeros_like(around), 1 + ahead, 1 + around], 1)]
    for ring in range(rings - 2):
        a, b = 1 + ring * segments, 1 + (ring + 1) * segments
        triangles.append(np.stack([a + around, a + ahead, b + ahead], 1))
        triangles.append(np.stack([a + around, b + ahead, b + around], 1))
    base = 1 + (rings - 2) * segments
    triangles.append(np.stack([np.full_like(around, last), base + around, base + ahead], 1))
    corners = np.concatenate(triangles)
    a, b, c = (points[corners[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, corners[:, k], areas)
    return corners, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def with_sphere(path: Path, folder: Path, segments: int) -> Path:
    """The scene with a bumpy sphere in place of its cubes. Returns its file."""
    tree = ET.parse(path)
    root = tree.getroot()
    for shape in [each for each in root.findall("shape") if each.get("type") == "cube"]:
        root.remove(shape)
    points, triangles, normals = displaced_sphere(segments)
    write_ply(folder / "sphere.ply", points, triangles, normals)
    sphere = ET.SubElement(root, "shape", id="sphere")
    make_ply_shape(sphere, "sphere.ply")
    ET.SubElement(sphere, "ref", id="white")
    return _written(tree, folder / "mesh.xml")
