"""Stages that frames are published to, sources that they are read from, and the trace of who worked
when.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import os
import sys
import time
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any

from pave import _pave
from pave.buffers import Frame, Metadata, channel_planes
from pave.checks import seconds, whole
from pave.device import Device, raw_device_or_host
from pave.errors import Error, UsageError

_POLICIES = {
    "block": _pave.QueuePolicy.block,
    "drop-oldest": _pave.QueuePolicy.drop_oldest,
    "drop-newest": _pave.QueuePolicy.drop_newest,
}


class Trace:
    """Time spans of a run; write() makes a file that chrome://tracing and Perfetto open. Any
    thread.
    """

    def __init__(self) -> None:
        self._trace = _pave.Trace()

    @contextmanager
    def span(self, name: str, detail: str = "") -> Iterator[None]:
        """Records the time that the with-block took, on the calling thread's row, also if it
        raises.
        """
        begin = time.monotonic_ns()
        try:
            yield
        finally:
            self._trace.span(name, begin, time.monotonic_ns(), detail)

    def name_thread(self, name: str) -> None:
        """Names the calling thread's row."""
        self._trace.name_thread(name)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes the file, whole or not at all. Raises RunError if it cannot be written."""
        self._trace.write(os.fspath(path))


def _let_go(stage: _pave.Stage, pid: int) -> None:
    """What becomes of a stage that nobody closed: its frames are kept, the data set stays open."""
    if os.getpid() != pid:
        # A forked child has no background thread to end, and owns no file.
        _pave.keep_forever(stage)
        return
    try:
        stage.abandon()
    except Error as error:
        print(f"pave: {error}", file=sys.stderr)


class Stage:
    """A ring of frame slots and the sink that a background thread flushes published frames to.

    `device` is where the slots' memory comes from, None for plain host memory. `uri`: "mem:NAME"
    (in this process; a frame keeps its slot until a source takes it), "mem:" (nobody reads it),
    "bp:PATH", "exr:DIR". `channels` are names that PAVE knows, or ("name", planes). `policy` says
    what happens when all slots are taken: "block" (acquire waits), "drop-oldest", "drop-newest".
    `timeout`, in seconds, bounds every wait. `resume` goes on behind the last frame of an
    unfinished data set. `frames_per_shard` frames of a bp: become durable together; `exr_names` is
    the spelling of EXR channels: "pave", "oidn" or "cycles".

    acquire() and publish() are for one thread, the rest for any. As a context manager it ends with
    close(), or with abandon() if the block raised; a stage that is dropped without either is
    abandoned. Raises UsageError for a bad URI or option or a place that exists already, RunError if
    the place cannot be written, InputError if `resume` finds broken data.
    """

    def __init__(
        self,
        device: Device | None,
        uri: str,
        *,
        width: int = 256,
        height: int = 256,
        channels: Sequence[str | tuple[str, int]] = (
            "color",
            "albedo",
            "direct",
            "normal",
            "depth",
        ),
        slots: int = 8,
        policy: str = "block",
        timeout: float = 30.0,
        resume: bool = False,
        frames_per_shard: int = 16,
        exr_names: str = "pave",
        trace: Trace | None = None,
    ) -> None:
        if policy not in _POLICIES:
            raise UsageError(f"unknown policy '{policy}'; there are {', '.join(_POLICIES)}")
        self.device: Device | None = device
        self.uri: str = uri
        self._pid = os.getpid()
        self._stage = _pave.Stage(
            device=raw_device_or_host(device),
            uri=uri,
            width=whole("width", width),
            height=whole("height", height),
            channels=channel_planes(channels),
            slots=whole("slots", slots),
            policy=_POLICIES[policy],
            timeout_ms=seconds("timeout", timeout),
            resume=resume,
            frames_per_shard=whole("frames_per_shard", frames_per_shard),
            exr_names=exr_names,
            trace=None if trace is None else trace._trace,
        )
        schema = self._stage.schema
        self.width: int = schema.width
        self.height: int = schema.height
        self.channels: tuple[str, ...] = tuple(name for name, _, _ in schema.layout())
        self._finalizer = weakref.finalize(self, _let_go, self._stage, self._pid)

    def _here(self) -> _pave.Stage:
        if os.getpid() != self._pid:
            raise UsageError(
                f"the stage of {self.uri} belongs to process {self._pid}, not its child"
            )
        return self._stage

    def acquire(self) -> Frame:
        """A free slot as a frame with the next number; waits for one as the policy says. Pixels are
        those of before.

        Raises RunError on the deadline, naming who holds the slots, or if the sink failed.
        """
        return Frame(self._here().acquire(), self.device)

    def publish(self, frame: Frame) -> None:
        """Hands the frame to the background thread and returns at once. From here on nobody should
        write to it.

        `frame` and what was made from it stay valid; they keep its slot. A frame that the policy
        "drop-newest" drops is released here, so that its slot is free for the next one. Raises
        UsageError if it is not an acquired frame of this stage, or its number is not above the last
        one.
        """
        if not self._here().publish(frame._frame):
            frame.release()

    def flush(self) -> None:
        """Returns when everything published before is durable (files) or visible (mem:); the lock
        is free meanwhile.

        Raises what went wrong in the background, or RunError on the deadline.
        """
        self._here().flush()

    def close(self) -> None:
        """flush(), then release; files get their closing record. Idempotent."""
        self._here().close()
        self._finalizer.detach()

    def abandon(self) -> None:
        """close() without the closing record: what was published is kept and the data set stays
        open for `resume`.
        """
        self._here().abandon()
        self._finalizer.detach()

    @property
    def first_index(self) -> int:
        """Number of the first frame to make: behind the last one there when resuming."""
        return self._stage.first_index

    @property
    def published(self) -> int:
        """Frames published by this stage, dropped ones included."""
        return self._stage.published

    @property
    def acknowledged(self) -> int:
        """Frames durable (files) or visible (mem:), those found when resuming included."""
        return self._stage.acknowledged

    @property
    def dropped(self) -> int:
        """Frames that the policy dropped."""
        return self._stage.dropped

    def __enter__(self) -> Stage:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
            return
        try:
            self.abandon()
        except Error as second:
            print(f"pave: {second}", file=sys.stderr)  # the first error is the one to raise

    def __repr__(self) -> str:
        return f"<pave.Stage {self.uri} {self.width}x{self.height} [{', '.join(self.channels)}]>"


class Source:
    """Frames of "mem:NAME", "bp:PATH" or "exr:DIR", the same for each. Used by one thread at a
    time, in one process.

    Files are checked against their manifest before any library parses them. A file source sees what
    was acknowledged when it was opened; a mem: source sees every frame that was published and not
    yet taken. With `device` the frames of files are read into that device's memory, and those of
    mem: are known to be in it, so that `cl_buffer()` works. Raises UsageError for a bad URI or a
    name that no stage has, InputError for broken data, or unfinished data unless
    `allow_unfinished`.
    """

    def __init__(
        self, uri: str, *, allow_unfinished: bool = False, device: Device | None = None
    ) -> None:
        self.uri: str = uri
        self.device: Device | None = device
        self._source: _pave.Source | None = _pave.Source.open(uri, allow_unfinished)
        schema = self._source.schema
        self.width: int = schema.width
        self.height: int = schema.height
        self.planes: dict[str, int] = {name: planes for name, planes, _ in schema.layout()}
        self.frame_byte_size: int = schema.slot_byte_size

    def _open(self) -> _pave.Source:
        if self._source is None:
            raise UsageError(f"the source {self.uri} is closed")
        return self._source

    @property
    def channels(self) -> list[str]:
        """Channel names in the order of memory; `planes` says how many planes each has."""
        return list(self.planes)

    @property
    def finished(self) -> bool:
        """True once the writer has closed the data set."""
        return self._open().finished

    @property
    def content_hash(self) -> str:
        """XXH3-128 hex over all pixels and metadata but the time spent: equal data sets have equal
        ones in any sink.
        """
        return self._open().content_hash()

    def metadata(self, position: int) -> Metadata:
        """A copy of one frame's metadata, without reading its pixels."""
        return Metadata(self._open().metadata(self._checked(position)))

    def read(self, position: int) -> Frame:
        """Frame `position`, 0 to len() - 1: mem: shares the slot itself, files are read and
        verified.

        Raises InputError naming the file if a checksum does not match.
        """
        raw = raw_device_or_host(self.device)
        return Frame(self._open().read(self._checked(position), raw), self.device)

    def read_all(self) -> list[Frame]:
        """Every frame, in order; of mem: those of one moment, whoever takes or adds some meanwhile."""
        raw = raw_device_or_host(self.device)
        return [Frame(frame, self.device) for frame in self._open().read_all(raw)]

    def next(self, timeout: float = 30.0) -> Frame | None:
        """The oldest frame not yet given by next(); None when there will be no more.

        mem: takes it out of the store, so that its slot is free when the caller lets go, and waits
        for one while the stage is open; raises PeerError after `timeout` seconds.
        """
        raw = self._open().next(seconds("timeout", timeout), raw_device_or_host(self.device))
        return None if raw is None else Frame(raw, self.device)

    def close(self) -> None:
        """Lets go of the files; frames read before stay valid. Idempotent."""
        self._source = None

    def _checked(self, position: int) -> int:
        count = len(self)
        if not 0 <= position < count:
            raise IndexError(f"{self.uri} has {count} frames; there is no position {position}")
        return position

    def __len__(self) -> int:
        return self._open().frame_count

    def __iter__(self) -> Iterator[Frame]:
        for position in range(len(self)):
            yield self.read(position)

    def __enter__(self) -> Source:
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "closed" if self._source is None else f"{len(self)} frames"
        return f"<pave.Source {self.uri} {self.width}x{self.height}, {state}>"


def write_exr(frame: Frame, path: str | os.PathLike[str], names: str = "pave") -> None:
    """Writes every channel of `frame` as one multi-layer EXR, whole or absent; a file there is
    replaced.

    `names` spells the layers as "pave", "oidn" or "cycles". Raises UsageError for another spelling,
    RunError if the file cannot be written.
    """
    _pave.write_exr(frame._frame, os.fspath(path), names)


def read_exr(path: str | os.PathLike[str], device: Device | None = None) -> Frame:
    """Reads what write_exr() wrote, into the memory of `device`, or of the host with None.

    Its bytes are checked before OpenEXR sees them. Raises InputError for anything else.
    """
    return Frame(_pave.read_exr(os.fspath(path), raw_device_or_host(device)), device)
