"""Checkpoints of a training run: whole or absent, checked before use, the last two kept.

SPDX-License-Identifier: BSD-3-Clause

One file holds magic, XXH3-128 of the rest, and torch's serialised state, which is read back with weights_only=True: tensors and
plain values, no code.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import torch

from pave.errors import InputError
from pave.files import hash_bytes, make_folder, read_bytes, write_atomic

FOLDER = "checkpoints"
SUFFIX = ".ckpt"
KEPT = 2
_MAGIC = b"PAVECKP1"
_HASH_SIZE = 32  # hex digits


def save_checkpoint(run: Path, state: dict[str, Any], step: int) -> Path:
    """Writes the state after `step` steps, then removes all but the last two. Durable on return. Raises RunError."""
    folder = run / FOLDER
    make_folder(folder)
    buffer = io.BytesIO()
    torch.save(state, buffer)
    payload = buffer.getvalue()
    path = folder / f"step-{step:010d}{SUFFIX}"
    write_atomic(path, _MAGIC + hash_bytes(payload).encode() + payload)
    for old in list_checkpoints(run)[:-KEPT]:
        old.unlink(missing_ok=True)
    return path


def list_checkpoints(run: Path) -> list[Path]:
    """Checkpoints of a run, oldest first."""
    return sorted((run / FOLDER).glob(f"step-*{SUFFIX}"))


def load_checkpoint(path: Path) -> dict[str, Any]:
    """The state in one file. Raises InputError for a file that is not what was written."""
    data = read_bytes(path)
    head = len(_MAGIC) + _HASH_SIZE
    if len(data) < head or data[: len(_MAGIC)] != _MAGIC:
        raise InputError(f"{path}: not a checkpoint")
    payload = data[head:]
    if hash_bytes(payload).encode() != data[len(_MAGIC) : head]:
        raise InputError(f"{path}: checksum differs; the file is damaged")
    try:
        return torch.load(io.BytesIO(payload), map_location="cpu", weights_only=True)
    except Exception as error:  # whatever torch raises for bytes that are no state
        raise InputError(f"{path}: cannot be read: {error}") from error


def load_latest(run: Path) -> tuple[dict[str, Any] | None, list[str]]:
    """State of the newest whole checkpoint, or None, and a remark for each damaged one that was passed over.

    Raises InputError if there are checkpoints and none is whole.
    """
    remarks: list[str] = []
    paths = list_checkpoints(run)
    for path in reversed(paths):
        try:
            return load_checkpoint(path), remarks
        except InputError as error:
            remarks.append(str(error))
    if paths:
        raise InputError(f"{run / FOLDER}: no whole checkpoint: {remarks[0]}")
    return None, remarks
