"""Models without a scene: glTF, GLB and OBJ with MTL, sound and broken.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import io
import json
import os
import random
import struct

import numpy as np
import pytest
from PIL import Image

import pave
from pave.rays import make_rays

DEVICE = os.environ.get("PAVE_DEVICE", "cpu")
SQUARE = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
UV = [(0, 1), (1, 1), (1, 0), (0, 0)]  # glTF: v = 0 is the image's top


def png(colours: list[list[tuple[int, int, int]]]) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.array(colours, dtype=np.uint8), "RGB").save(stream, "PNG")
    return stream.getvalue()


def glb(
    material: dict, image: bytes | None = None, node: dict | None = None, more: tuple = ()
) -> bytes:
    """A square of one material under one node, and under `more` of them."""
    parts = [
        struct.pack("<12f", *(x for p in SQUARE for x in p)),
        struct.pack("<8f", *(x for p in UV for x in p)),
        struct.pack("<6H", 0, 1, 2, 0, 2, 3),
    ]
    if image is not None:
        parts.append(image)
    views, body = [], b""
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(part)})
        body += part + b"\0" * (-len(part) % 4)
    low, high = [-1, -1, 0], [1, 1, 0]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(1 + len(more)))}],
        "nodes": [{"mesh": 0, **other} for other in (node or {}, *more)],
        "meshes": [
            {
                "primitives": [
                    {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}
                ]
            }
        ],
        "materials": [material],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 4,
                "type": "VEC3",
                "min": low,
                "max": high,
            },
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}],
    }
    if image is not None:
        document["images"] = [{"bufferView": 3, "mimeType": "image/png"}]
        document["textures"] = [{"source": 0}]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def front_view(path, channels=("color", "albedo", "position"), size=16) -> dict[str, np.ndarray]:
    """Seen along -z, the square [-1, 1]^2 fills the picture."""
    scene = pave.load_scene(path)
    device = pave.Device(DEVICE)
    renderer = pave.Renderer(device, scene)
    view = pave.look_at((0, 0, 4), (0, 0, 0), fov=2 * np.degrees(np.arctan(0.25)))
    with pave.Stage(device, "mem:", channels=channels, slots=1, width=size, height=size) as stage:
        frame = stage.acquire()
        renderer.render(view, frame, spp=16, seed=1)
        return {name: np.moveaxis(frame[name].numpy(copy=True), 0, 2) for name in channels}


def rough(**more) -> dict:
    return {"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1, **more}}


def test_glb_has_its_colour_and_nodes(tmp_path):
    path = tmp_path / "square.glb"
    path.write_bytes(glb(rough(baseColorFactor=[0.2, 0.5, 0.8, 1])))
    image = front_view(path)
    assert np.allclose(image["albedo"], (0.2, 0.5, 0.8), atol=1e-5)
    # In a white sky of radiance 1 a flat diffuse square is its albedo.
    assert np.allclose(image["color"].mean((0, 1)), (0.2, 0.5, 0.8), rtol=0.02)
    path.write_bytes(glb(rough(), node={"translation": [3, 4, 5], "scale": [2, 1, 1]}))
    scene = pave.load_scene(path)
    assert np.allclose(scene.bounds_min, (1, 3, 5))
    assert np.allclose(scene.bounds_max, (5, 5, 5))


def test_a_mesh_of_several_nodes_is_there_once(tmp_path):
    path = tmp_path / "square.glb"
    far = {"translation": [0, 0, -3], "scale": [5, 5, 1]}
    mirrored = {"translation": [0.5, 0, 1], "scale": [-0.25, 0.5, 1]}
    material = rough(baseColorFactor=[0.2, 0.5, 0.8, 1])
    path.write_bytes(glb(material, node=far, more=(mirrored, {"translation": [-9, 0, 0]})))
    scene = pave.load_scene(path)
    assert scene.shape_count == 3
    assert np.allclose(scene.bounds_min, (-10, -5, -3))
    assert np.allclose(scene.bounds_max, (5, 5, 1))
    device = pave.Device(DEVICE)
    image = front_view(path, channels=("albedo", "object", "normal"))
    assert np.allclose(image["albedo"], (0.2, 0.5, 0.8), atol=1e-5)
    assert np.allclose(image["normal"], (0, 0, 1), atol=1e-5), "front stays front"
    assert image["object"][8, 11, 0] == 1
    assert image["object"][0, 0, 0] == 0
    for lanes in (1, 16):
        hits = pave.RayTracer(device, scene, lanes).trace_closest(
            make_rays([[0.6, 0.2, 9], [0, 0.7, 9], [-9, 0, 9], [0, 9, 9]], [[0, 0, -1]])
        )
        assert hits["shape"].tolist() == [1, 0, 2, -1]
        assert hits["part"].tolist() == [0, 0, 0, -1]
        assert hits["t"][:3].tolist() == [8, 12, 9]
    # A light is no group's: it is there once a node, and shines to its front (and, a little, from
    # one square by the other's back).
    path.write_bytes(glb({**rough(), "emissiveFactor": [1, 1, 1]}, node=far, more=(mirrored,)))
    colour = front_view(path)["color"]
    assert colour.min() > 1 - 1e-5
    assert np.allclose(colour[8, 11], 1, atol=1e-5)


def test_glb_image_is_the_right_way_up(tmp_path):
    image = png([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (255, 255, 255)]])
    path = tmp_path / "square.glb"
    path.write_bytes(glb(rough(baseColorTexture={"index": 0}), image))
    albedo = front_view(path)["albedo"]
    assert np.allclose(albedo[4, 4], (1, 0, 0), atol=0.15), "upper left"
    assert np.allclose(albedo[4, 11], (0, 1, 0), atol=0.15)
    assert np.allclose(albedo[11, 4], (0, 0, 1), atol=0.15)


def test_glb_emission_is_the_light(tmp_path):
    path = tmp_path / "square.glb"
    path.write_bytes(glb({**rough(), "emissiveFactor": [0.25, 0.5, 1]}))
    colour = front_view(path)["color"]
    assert np.allclose(colour[8, 8], (0.25, 0.5, 1), atol=1e-5), "no sky beside a light"


def test_obj_with_its_materials(tmp_path):
    (tmp_path / "map.png").write_bytes(png([[(255, 0, 0)], [(0, 0, 255)]]))
    (tmp_path / "two.mtl").write_text(
        "newmtl plain\nKd 0.3 0.6 0.1\nd 0.5\nnewmtl mapped\nKd 1 1 1\nmap_Kd map.png\n"
    )
    path = tmp_path / "two.obj"
    path.write_text(
        "mtllib two.mtl\nv -1 -1 0\nv 0 -1 0\nv 1 -1 0\nv 1 1 0\nv 0 1 0\nv -1 1 0\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
        "usemtl plain\nf 1 2 5 6\nusemtl mapped\nf 2/1 3/2 4/3 5/4\n"
    )
    scene = pave.load_scene(path)
    assert any("transparency is left out" in warning for warning in scene.warnings)
    albedo = front_view(path)["albedo"]
    assert np.allclose(albedo[8, 3], (0.3, 0.6, 0.1), atol=1e-5)
    assert np.allclose(albedo[3, 12], (1, 0, 0), atol=0.15), "the image's top is above"
    assert np.allclose(albedo[12, 12], (0, 0, 1), atol=0.15)


def test_the_whole_model_is_in_the_picture(tmp_path):
    path = tmp_path / "square.glb"
    path.write_bytes(glb(rough(), node={"translation": [30, 4, 5]}))
    scene = pave.load_scene(path)
    device = pave.Device(DEVICE)
    renderer = pave.Renderer(device, scene)
    with pave.Stage(device, "mem:", channels=["depth"], slots=1, width=64, height=64) as stage:
        frame = stage.acquire()
        renderer.render(None, frame, spp=1)
        hit = np.isfinite(frame["depth"].numpy(copy=True)[0])
    assert 0.1 < hit.mean() < 0.9
    assert not hit[[0, -1]].any()
    assert not hit[:, [0, -1]].any()


def test_images_elsewhere_are_refused(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd ../../etc/hostname.png\n")
    path = tmp_path / "a.obj"
    path.write_text("mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    with pytest.raises(pave.InputError, match="is not in the model's folder"):
        pave.load_scene(path)


def test_broken_models_are_one_error(tmp_path):
    whole = glb(rough(baseColorTexture={"index": 0}), png([[(1, 2, 3)]]))
    rng = random.Random(5)
    path = tmp_path / "broken.glb"
    cut = [whole[: len(whole) * i // 12] for i in range(12)]
    garbled = []
    for _ in range(40):
        data = bytearray(whole)
        for _ in range(rng.randint(1, 6)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        garbled.append(bytes(data))
    errors = []
    for data in cut + garbled:
        path.write_bytes(data)
        try:
            pave.load_scene(path)
        except pave.InputError as error:
            errors.append(str(error))
    assert len(errors) >= len(cut)
    for message in errors:
        assert "broken.glb" in message
        assert "\n" not in message
