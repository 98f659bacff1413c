"""Writes the images of this folder (map.png, stone.jpg, sky.exr) and ../meshes/vase.obj, which has
texture coordinates.

SPDX-License-Identifier: BSD-3-Clause
"""

import math
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

FOLDER = Path(__file__).parent


def write_map(path: Path, width: int = 96, height: int = 64) -> None:
    """Colours that tell every corner from the others, under a grid and a disk off the centre."""
    y, x = np.mgrid[0:height, 0:width] + 0.5
    u, v = x / width, y / height
    image = np.stack([0.15 + 0.8 * u, 0.2 + 0.7 * v, 0.9 - 0.6 * u * v], axis=2)
    image[(np.minimum(x % 16, y % 16) < 2)] *= 0.25
    image[np.hypot(u - 0.25, (v - 0.3) * height / width) < 0.12] = (0.95, 0.9, 0.1)
    Image.fromarray((255 * image).round().astype(np.uint8), "RGB").save(path, optimize=True)


def write_stone(path: Path, size: int = 64) -> None:
    """Smooth noise that repeats at the edges."""
    y, x = np.mgrid[0:size, 0:size] * (2 * math.pi / size)
    rng = np.random.default_rng(7)
    noise = np.zeros((size, size))
    for _ in range(40):
        i, j = rng.integers(-6, 7, 2)
        noise += np.cos(i * x + j * y + rng.uniform(0, 7)) / (1 + math.hypot(i, j))
    noise = (noise - noise.min()) / np.ptp(noise)
    image = np.stack([0.3 + 0.6 * noise, 0.28 + 0.5 * noise, 0.25 + 0.45 * noise], axis=2)
    Image.fromarray((255 * image).round().astype(np.uint8), "RGB").save(path, quality=90)


def write_sky(path: Path, width: int = 64, height: int = 32) -> None:
    """Blue above, brown below, a small bright sun, a wide warm glow; latitude and longitude."""
    y, x = np.mgrid[0:height, 0:width] + 0.5
    theta, phi = math.pi * y / height, 2 * math.pi * x / width
    up = np.cos(theta)[..., None]
    sky = np.where(up > 0, (0.25, 0.4, 0.8) + 0.4 * (1 - up), (0.12, 0.09, 0.07))
    towards = np.sin(theta) * np.cos(phi - 4.1) * math.sin(0.9) + np.cos(theta) * math.cos(0.9)
    sky = sky + np.array((2.0, 1.1, 0.5)) * np.exp(6 * (towards - 1))[..., None]
    sky = sky + np.array((90.0, 80.0, 60.0)) * np.exp(250 * (towards - 1))[..., None]
    channels = {name: sky[..., i].astype(np.float32).copy() for i, name in enumerate("RGB")}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))


def write_vase(path: Path, around: int = 24, along: int = 16) -> None:
    """A surface of revolution about y; its seam and rows share positions, not coordinates."""
    lines = ["# by make_textures.py"]
    for j in range(along + 1):
        v = j / along
        radius = 0.45 + 0.25 * math.sin(1.2 + 4.4 * v) + 0.1 * v
        for i in range(around):
            angle = 2 * math.pi * i / around
            x, z = radius * math.cos(angle), -radius * math.sin(angle)
            lines.append(f"v {x:.6f} {1.6 * v:.6f} {z:.6f}")
    lines += [
        f"vt {i / around:.6f} {j / along:.6f}" for j in range(along + 1) for i in range(around + 1)
    ]
    for j in range(along):
        for i in range(around):
            corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            words = [
                f"{b * around + a % around + 1}/{b * (around + 1) + a + 1}" for a, b in corners
            ]
            lines.append("f " + " ".join(words))
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    write_map(FOLDER / "map.png")
    write_stone(FOLDER / "stone.jpg")
    write_sky(FOLDER / "sky.exr")
    write_vase(FOLDER.parent / "meshes" / "vase.obj")
