"""Frames as training data: the papers' DataLoader and a torch data set, the same for mem:, bp: and
exr:.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import cast

import torch
import torch.utils.data

from pave import _pave
from pave.buffers import Frame, Metadata, count_copy
from pave.errors import UsageError
from pave.stage import Source

Sample = dict[str, torch.Tensor]

CACHE_BYTES = 2 << 30  # frames of files kept in memory, by default


class _Frames:
    """The frames of one URI: opened once, kept in memory up to a budget, opened anew in every
    forked or spawned worker.

    mem: frames are handles on the stage's slots, taken when opened; they need no budget, and their
    slots stay taken while this lives. File frames are read and verified when first asked for; while
    the budget lasts they are kept, those that came first: for passes over more data than fit, that
    is better than keeping the last ones. Any thread.
    """

    def __init__(self, uri: str, cache_bytes: int, allow_unfinished: bool) -> None:
        if cache_bytes < 0:
            raise UsageError(f"cache_bytes must be 0 or more, not {cache_bytes}")
        self.uri = uri
        self._cache_bytes = cache_bytes
        self._allow_unfinished = allow_unfinished
        self._in_memory = uri.startswith("mem:")
        self._open()

    def _open(self) -> None:
        self._pid = os.getpid()
        self._lock = threading.Lock()
        self._source = Source(self.uri, allow_unfinished=self._allow_unfinished)
        self.width, self.height = self._source.width, self._source.height
        self.planes = dict(self._source.planes)
        self._cache: dict[int, Frame] = {}
        if self._in_memory:
            self._cache = dict(enumerate(self._source.read_all()))
        self._count = len(self._cache) if self._in_memory else len(self._source)

    def _here(self) -> Source:
        if os.getpid() != self._pid and not self._in_memory:
            # The parent's pages are shared by the kernel; its files and lock are not, and its source
            # is not this process's to close.
            cache = self._cache
            _pave.keep_forever(self._source)
            self._open()
            self._cache = cache
        return self._source

    def frame(self, position: int) -> Frame:
        source = self._here()
        if self._in_memory:
            return self._cache[position]
        with self._lock:
            frame = self._cache.get(position)
            if frame is None:
                frame = source.read(position)
                if (len(self._cache) + 1) * source.frame_byte_size <= self._cache_bytes:
                    self._cache[position] = frame
            return frame

    def metadata(self, position: int) -> Metadata:
        source = self._here()
        if self._in_memory:
            return self._cache[position].metadata
        with self._lock:
            return source.metadata(position)

    def __len__(self) -> int:
        return self._count

    def __getstate__(self) -> tuple[str, int, bool]:
        if self._in_memory:
            raise UsageError(
                f"{self.uri} lives in one process: use num_workers=0 or the 'fork' start method"
            )
        return self.uri, self._cache_bytes, self._allow_unfinished

    def __setstate__(self, state: tuple[str, int, bool]) -> None:
        self.uri, self._cache_bytes, self._allow_unfinished = state
        self._in_memory = False
        self._open()


def _check_channels(frames: _Frames, channels: str | Sequence[str] | None) -> tuple[str, ...]:
    if channels is None:
        return tuple(frames.planes)
    names = (channels,) if isinstance(channels, str) else tuple(channels)
    for name in names:
        if name not in frames.planes:
            known = ", ".join(frames.planes)
            raise UsageError(f"{frames.uri} has no channel '{name}'; it has {known}")
    if not names or len(set(names)) != len(names):
        raise UsageError(f"{frames.uri}: name each channel once, and one at least")
    return names


class Dataset(torch.utils.data.Dataset[Sample]):
    """Frames as a torch map-style data set: dict of (planes, H, W) float32 CPU tensors by channel
    name.

    `channels` None takes all, `indices` None all frames (positions in the data set). Tensors are
    views of the frame's memory, with no copy: those of mem: are the stage's very slots, so do not
    change them in place. Frames of files are kept in memory up to `cache_bytes` in each process,
    and verified when read.

    Works with torch's DataLoader and its workers: forked ones share what was read before and open
    the files anew; with "spawn" only files can be handed on. Raises UsageError for wrong channel
    names (listing those there are) or indices, InputError for broken data.
    """

    def __init__(
        self,
        uri: str,
        channels: str | Sequence[str] | None = None,
        indices: Sequence[int] | None = None,
        *,
        cache_bytes: int = CACHE_BYTES,
        allow_unfinished: bool = False,
    ) -> None:
        self._set(_Frames(uri, cache_bytes, allow_unfinished), channels, indices)

    def _set(
        self,
        frames: _Frames,
        channels: str | Sequence[str] | None,
        indices: Sequence[int] | None,
    ) -> None:
        self._frames = frames
        self.uri: str = frames.uri
        self.channels: tuple[str, ...] = _check_channels(frames, channels)
        count = len(frames)
        positions = range(count) if indices is None else [int(i) for i in indices]
        for position in positions:
            if not 0 <= position < count:
                raise UsageError(
                    f"{frames.uri} has {count} frames; there is no position {position}"
                )
        self.indices: tuple[int, ...] = tuple(positions)

    @classmethod
    def _of(
        cls, frames: _Frames, channels: Sequence[str], indices: Sequence[int] | None
    ) -> Dataset:
        dataset = cls.__new__(cls)
        dataset._set(frames, channels, indices)
        return dataset

    @property
    def planes(self) -> dict[str, int]:
        """Planes of each of this data set's channels."""
        return {name: self._frames.planes[name] for name in self.channels}

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of every frame."""
        return self._frames.height, self._frames.width

    def frame(self, index: int) -> Frame:
        """The frame behind sample `index`, with its metadata."""
        return self._frames.frame(self.indices[index])

    def metadata(self, index: int) -> Metadata:
        """Metadata of sample `index`, without reading its pixels."""
        return self._frames.metadata(self.indices[index])

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: int) -> Sample:
        frame = self.frame(index)
        return {name: frame[name].torch() for name in self.channels}

    def __iter__(self) -> Iterator[Sample]:
        for index in range(len(self)):
            yield self[index]

    def __repr__(self) -> str:
        return f"<pave.Dataset {self.uri}, {len(self)} frames [{', '.join(self.channels)}]>"


def split_indices(
    count: int, seed: int = 0, fractions: Sequence[float] = (0.6, 0.2, 0.2)
) -> tuple[list[int], list[int], list[int]]:
    """Positions 0 to count - 1, dealt into train, test and validation: disjoint, complete, the same
    on every machine.

    The positions are ordered by a hash of (seed, position), so no library's random numbers come in;
    test and validation take the nearest whole number to their share, training the rest. Each list
    rises. Raises UsageError for fractions that are not three numbers from 0 up with sum 1.
    """
    shares = [float(x) for x in fractions]
    if len(shares) != 3 or min(shares) < 0 or abs(sum(shares) - 1) > 1e-9:
        raise UsageError(f"a split is three fractions with sum 1, not {tuple(fractions)}")
    order = sorted(range(count), key=lambda i: (_pave.hash_bytes(f"split {seed} {i}".encode()), i))
    test_end = min(count, int(shares[1] * count + 0.5))
    validation_end = min(count, test_end + int(shares[2] * count + 0.5))
    return (
        sorted(order[validation_end:]),
        sorted(order[:test_end]),
        sorted(order[test_end:validation_end]),
    )


class DataLoader(torch.utils.data.Dataset[Sample]):
    """The papers' loader: one code for what is staged in this process (mem:NAME) and what was
    written (bp:, exr:).

        loader = pave.DataLoader("bp:cornell.bp")
        loader.open(["albedo", "direct", "normal", "depth", "color"])
        train, test, validation = loader.get_split()
        loader.close()

    open() connects and fixes the variables, read() fetches what is there now; get(), iteration and
    len() give samples, dicts of (planes, H, W) float32 tensors by channel name, as Dataset does. It
    is itself a torch data set, so it goes into torch.utils.data.DataLoader as in the papers'
    listing; what needs data opens all variables if open() was not called. `seed` is the split's. As
    a context manager it closes at the end; data sets that it gave keep working.
    """

    def __init__(
        self,
        uri: str,
        *,
        seed: int = 0,
        cache_bytes: int = CACHE_BYTES,
        allow_unfinished: bool = False,
    ) -> None:
        self.uri: str = uri
        self.seed: int = seed
        self._cache_bytes = cache_bytes
        self._allow_unfinished = allow_unfinished
        self._dataset: Dataset | None = None
        self._closed = False

    def open(self, variables: str | Sequence[str] | None = None) -> DataLoader:
        """Connects to the data and fixes the variables, all of them with None; returns this loader.

        mem:NAME is what was staged in this process so far, slot by slot and without a copy. Raises
        UsageError for a name that no stage has, or wrong variables (listing those there are);
        InputError for broken or unfinished data.
        """
        frames = _Frames(self.uri, self._cache_bytes, self._allow_unfinished)
        self._dataset = Dataset._of(frames, _check_channels(frames, variables), None)
        self._closed = False
        return self

    def read(self) -> Dataset:
        """Fetches what is there now, frames that came since open() included, as a data set of the
        opened variables.
        """
        return self.open(self._opened().channels)._opened()

    def get(self, what: str | int) -> torch.Tensor | Sample:
        """By number one sample (views, no copy); by name that variable of all frames, (N, planes,
        H, W), a copy.

        Raises UsageError for a wrong name, IndexError for a wrong number.
        """
        dataset = self._opened()
        if isinstance(what, str):
            (name,) = _check_channels(dataset._frames, what)
            count_copy(len(dataset))
            return torch.stack([dataset.frame(i)[name].torch() for i in range(len(dataset))])
        return dataset[what]

    def get_split(
        self, fractions: Sequence[float] = (0.6, 0.2, 0.2), seed: int | None = None
    ) -> tuple[Dataset, Dataset, Dataset]:
        """Train, test and validation data sets, in this order; 60, 20 and 20 percent as in the
        papers.

        Every frame is in exactly one. Depends on the seed and the number of frames alone, see
        split_indices().
        """
        dataset = self._opened()
        parts = split_indices(len(dataset), self.seed if seed is None else seed, fractions)
        train, test, validation = (
            Dataset._of(dataset._frames, dataset.channels, part) for part in parts
        )
        return train, test, validation

    def close(self) -> None:
        """Lets go of the data; data sets and tensors that were given out keep working. Idempotent.

        A closed loader can be opened again.
        """
        self._dataset = None
        self._closed = True

    @property
    def channels(self) -> tuple[str, ...]:
        """The variables that open() fixed."""
        return self._opened().channels

    def _opened(self) -> Dataset:
        if self._closed:
            raise UsageError(f"the loader of {self.uri} is closed; open() it again")
        if self._dataset is None:
            self.open()
        return cast(Dataset, self._dataset)

    def __len__(self) -> int:
        return len(self._opened())

    def __getitem__(self, index: int) -> Sample:
        return self._opened()[index]

    def __iter__(self) -> Iterator[Sample]:
        return iter(self._opened())

    def __enter__(self) -> DataLoader:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<pave.DataLoader {self.uri}>"
