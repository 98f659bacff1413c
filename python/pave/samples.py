"""Training images in the form that the networks take, in memory where they fit, in an order that only the seed decides.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import torch

from pave.errors import InputError, UsageError
from pave.export import pad_to_multiple, padded_side
from pave.schema import TARGET, Sample, Schema

Batch = tuple[torch.Tensor, torch.Tensor]


class EncodedImages:
    """Encoded (buffers, image) pairs of one split.

    `samples` is any sequence of dicts of (C, H, W) float tensors by channel name, such as pave.Dataset. Up to `cache_bytes`
    everything is encoded once and kept as two tensors; larger sets are encoded as they are read, one batch ahead in another
    thread. Both sides of what comes out are multiples of `multiple`: the last row and column are repeated, as when the
    network draws; `height` and `width` are those of the image itself.
    """

    def __init__(
        self,
        samples: Sequence[Sample],
        schema: Schema,
        cache_bytes: int,
        name: str,
        multiple: int = 1,
    ):
        if len(samples) == 0:
            raise UsageError(f"the {name} split has no images")
        self.samples, self.schema, self.name, self.multiple = samples, schema, name, multiple
        self.height, self.width = image_size(samples)
        planes = schema.in_planes + schema.output_planes
        pixels = padded_side(self.height, multiple) * padded_side(self.width, multiple)
        byte_size = 4 * planes * pixels * len(samples)
        self.cache: Batch | None = None
        if byte_size <= cache_bytes:
            pairs = [self._encode(index) for index in range(len(samples))]
            self.cache = _stack([b for b, _ in pairs]), _stack([t for _, t in pairs])

    def __len__(self) -> int:
        return len(self.samples)

    def _encode(self, index: int) -> Batch:
        sample = self.samples[index]
        buffers, target = self.schema.encode_inputs(sample), self.schema.encode_target(sample)
        for what, planes in (("an input", buffers), (TARGET, target)):
            if not bool(torch.isfinite(planes).all()):
                raise InputError(f"image {index} of the {self.name} split: {what} is not finite")
        if tuple(target.shape[-2:]) != (self.height, self.width):
            raise InputError(
                f"image {index} of the {self.name} split is {target.shape[-1]}x{target.shape[-2]}, "
                f"the others are {self.width}x{self.height}"
            )
        return pad_to_multiple(buffers, self.multiple), pad_to_multiple(target, self.multiple)

    def batch(self, indices: torch.Tensor) -> Batch:
        """Images by index, channels last in memory."""
        if self.cache is not None:
            return self.cache[0][indices], self.cache[1][indices]
        pairs = [self._encode(int(index)) for index in indices]
        return _stack([b for b, _ in pairs]), _stack([t for _, t in pairs])

    def batches(self, order: Sequence[torch.Tensor]) -> Iterator[Batch]:
        """The batches of `order` one after the other."""
        if self.cache is not None:
            yield from (self.batch(indices) for indices in order)
            return
        with ThreadPoolExecutor(1) as pool:
            ahead = None
            for indices in order:
                coming = pool.submit(self.batch, indices)
                if ahead is not None:
                    yield ahead.result()
                ahead = coming
            if ahead is not None:
                yield ahead.result()


def image_size(samples: Sequence[Sample]) -> tuple[int, int]:
    """(height, width) of the first image."""
    if TARGET not in samples[0]:
        raise UsageError(f"missing channel: {TARGET} (there are {', '.join(sorted(samples[0]))})")
    height, width = samples[0][TARGET].shape[-2:]
    return int(height), int(width)


def _stack(images: Sequence[torch.Tensor]) -> torch.Tensor:
    return torch.stack(list(images)).contiguous(memory_format=torch.channels_last)


def epoch_order(count: int, batch: int, seed: int, epoch: int) -> list[torch.Tensor]:
    """Indices of each batch of one epoch: a permutation that depends on seed and epoch alone, so that a resumed run
    finds its place. A last batch that would be short is left out, unless it is the only one."""
    # torch's generator looks at the low 32 bits of a seed alone: both numbers have to be in them.
    key = (seed * 0x9E3779B1 + epoch) & 0xFFFFFFFF
    generator = torch.Generator().manual_seed(key)
    order = torch.randperm(count, generator=generator)
    if count < batch:
        return [order]
    return list(order[: count // batch * batch].split(batch))


def mirror_batch(buffers: torch.Tensor, target: torch.Tensor, schema: Schema, step: int) -> Batch:
    """Every second step mirrored left to right: the picture of the mirrored world by the mirrored camera.

    World normals and positions change the sign of x, so that the mirrored world is a possible one. What is not mirrored by
    it, a red left wall, becomes a variant: use it where scenes vary, not to learn one by heart.
    """
    if step % 2 == 0:
        return buffers, target
    buffers = buffers.flip(-1)
    for spec in schema.inputs:
        if spec.encode in ("signed", "position"):
            plane = schema.first_plane(spec.channel)
            buffers[:, plane] = -buffers[:, plane]
    return buffers, target.flip(-1)
