"""Small made-up frames for the training tests: a lit floor and a ball, with bounced light that follows from the buffers.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Imported by the test files whose networks are too small for threads to be worth their waiting for each other."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def make_sample(index: int, size: int = 32, height: int | None = None) -> dict[str, torch.Tensor]:
    """One frame, the same for the same index: all channels, misses, radiance far above 1, normals of every sign."""
    generator = torch.Generator().manual_seed(1000 + index)
    height = height or size
    y, x = torch.meshgrid(torch.linspace(-1, 1, height), torch.linspace(-1, 1, size), indexing="ij")
    shift = torch.rand(2, generator=generator) - 0.5
    u, v = (x - shift[0]) / 0.5, (y - shift[1]) / 0.5
    ball = (u * u + v * v) < 1
    miss = y < -0.8
    z = (1 - u * u - v * v).clamp_min(0).sqrt()
    normal = torch.where(ball, torch.stack([u, -v, z]), torch.tensor([0.0, 1.0, 0.0]).view(3, 1, 1))
    normal = torch.nn.functional.normalize(normal, dim=0) * ~miss
    depth = torch.where(ball, 3 - z, 3 + 2 * (1 - y))
    depth = torch.where(miss, torch.inf, depth)[None]
    tint = 0.2 + 0.7 * torch.rand(3, 1, 1, generator=generator)
    albedo = torch.where(ball, tint, torch.tensor([0.7, 0.6, 0.5]).view(3, 1, 1)) * ~miss
    lamp = ((x * x + (y - 0.7) ** 2) < 0.02).float()
    lambert = (normal * torch.tensor([0.4, 0.8, 0.45]).view(3, 1, 1)).sum(0).clamp_min(0)
    direct = albedo * lambert + 17 * lamp
    bounced = 0.15 * albedo * (1.2 + normal[1]) * (1 + 0.4 * x)
    position = torch.stack([x, -y, torch.where(miss, torch.zeros_like(x), z)])
    return {
        "color": direct + bounced,
        "albedo": albedo,
        "direct": direct,
        "normal": normal,
        "depth": depth,
        "position": position,
    }


def make_samples(count: int, first: int = 0, size: int = 32) -> list[dict[str, torch.Tensor]]:
    """Frames first .. first + count."""
    return [make_sample(first + index, size) for index in range(count)]
