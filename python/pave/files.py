"""Files that are whole or absent, and the manifest that tells whether they are still what was written.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pave.errors import InputError, RunError

MANIFEST = "run-manifest.json"


def hash_bytes(data: bytes) -> str:
    """XXH3-128 hex, by the binding's function: one hash everywhere."""
    import pave

    return pave.hash_bytes(data)


def write_atomic(path: Path, data: bytes) -> None:
    """Writes, syncs, renames, syncs the folder. A crash leaves the old file or the new one. Raises RunError.

    What is beside its name until then goes when anything is raised, Ctrl-C included; after a kill remove_stale() does it.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
        sync_folder(path.parent)
    except BaseException as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise RunError(f"{path}: cannot be written: {error.strerror or error}") from error
        raise


def write_json(path: Path, record: Any) -> None:
    """A JSON file for people and machines, whole or absent. Raises RunError."""
    write_atomic(path, (json.dumps(record, indent=1) + "\n").encode())


def remove_stale(folder: Path) -> None:
    """Removes what write_atomic() of a process that is no more left half-written in `folder`, which may be missing."""
    for partial in folder.glob(".*.tmp"):
        number = partial.name.split(".")[-2]
        if number.isdecimal() and not _is_running(int(number)):
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)  # sends nothing
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass  # somebody else's
    return True


def sync_folder(folder: Path) -> None:
    """Makes renames in `folder` durable."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def make_folder(folder: Path) -> None:
    """Makes a folder and its parents. Raises RunError if that cannot be, or if nothing may be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"{folder}: cannot be made: {error.strerror or error}") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise RunError(f"{folder}: is not writable")


def read_bytes(path: Path) -> bytes:
    """The file's bytes. Raises InputError that names it."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def write_manifest(folder: Path, hashes: Mapping[str, str]) -> None:
    """Writes the checksums of `hashes` (file name -> XXH3-128 hex). Files named before stay if they are not given."""
    entries: dict[str, str] = {}
    path = folder / MANIFEST
    if path.exists():
        entries = _entries(path)
    entries.update(hashes)
    text = json.dumps({"format": "pave-run", "version": 1, "xxh3_128": entries}, indent=1) + "\n"
    write_atomic(path, text.encode())


def verify_manifest(folder: Path, names: Iterable[str]) -> None:
    """Raises InputError naming the first of `names` that is missing or not what the manifest says."""
    path = folder / MANIFEST
    entries = _entries(path)
    for name in names:
        if name not in entries:
            raise InputError(f"{path}: has no checksum of {name}; export the run again")
        if hash_bytes(read_bytes(folder / name)) != entries[name]:
            raise InputError(f"{folder / name}: checksum differs from {path}; the file is damaged")


def _entries(path: Path) -> dict[str, str]:
    try:
        record = json.loads(read_bytes(path))
        entries = record["xxh3_128"]
        if record["format"] != "pave-run" or not all(
            isinstance(key, str) and isinstance(value, str) for key, value in entries.items()
        ):
            raise ValueError("not a manifest of a run")
        return dict(entries)
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a manifest of a run: {error}") from error
