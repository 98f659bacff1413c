"""Files are whole or absent, and nothing half-written stays behind.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pave import files
from pave.errors import RunError
from pave.image import write_png

WRITERS = {
    "bytes": lambda path: files.write_atomic(path, b"new"),
    "png": lambda path: write_png(np.zeros((3, 4, 4), np.float32), path),
}


@pytest.fixture(params=WRITERS)
def write(request):
    return WRITERS[request.param]


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("error", [KeyboardInterrupt("SIGINT"), MemoryError(), OSError(28, "full")])
def test_nothing_half_written_whatever_is_raised(tmp_path, monkeypatch, write, call, error):
    path = tmp_path / "x.png"
    path.write_bytes(b"old")

    def fail(*_):
        raise error

    monkeypatch.setattr(os, call, fail)
    with pytest.raises(RunError if isinstance(error, OSError) else type(error)):
        write(path)
    assert [each.name for each in tmp_path.iterdir()] == ["x.png"]
    assert path.read_bytes() == b"old"


def test_images_are_durable_on_return(tmp_path, monkeypatch, write):
    """Synced before they get their name, and the folder after it: what docs/errors.md says of every file."""
    done = []
    for call in ("fsync", "replace"):
        real = getattr(os, call)

        def note(*arguments, call=call, real=real):
            done.append(call)
            return real(*arguments)

        monkeypatch.setattr(os, call, note)
    write(tmp_path / "x.png")
    assert done == ["fsync", "replace", "fsync"]


def test_what_dead_processes_left_is_removed(tmp_path: Path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait(timeout=60)
    stale = [tmp_path / f".a.json.{gone.pid}.tmp", tmp_path / f".b.{10**30}.tmp"]
    kept = [
        tmp_path / f".a.json.{os.getpid()}.tmp",  # of a writer that is at work
        tmp_path / f".a.json.{os.getppid()}.tmp",
        tmp_path / ".notes.tmp",
        tmp_path / "a.json",
        tmp_path / f"a.{gone.pid}.tmp",
    ]
    for path in (*stale, *kept):
        path.write_text("x")
    files.remove_stale(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(kept)
    files.remove_stale(tmp_path / "missing")
