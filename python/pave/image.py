"""Single images: multi-layer EXR for data, PNG for a quick look.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pave.errors import RunError, UsageError
from pave.files import write_atomic

if TYPE_CHECKING:
    import numpy as np

    import pave


EXR_NAMES = ("pave", "oidn", "cycles")


def check_output(path: Path, names: str = "pave", channels: Sequence[str] = ("color",)) -> None:
    """Raises before any work is done if `channels` cannot become the image `path`."""
    if path.suffix.lower() not in (".exr", ".png"):
        raise UsageError(f"{path}: the name must end in .exr or .png")
    if names not in EXR_NAMES:
        raise UsageError(f"--names {names}: there are {', '.join(EXR_NAMES)}")
    if path.suffix.lower() == ".png" and "color" not in channels:
        raise UsageError(f"{path}: a PNG shows the channel 'color', which is not among --channels")
    folder = path.parent if str(path.parent) else Path(".")
    if not folder.is_dir():
        raise RunError(f"{path}: the folder {folder} does not exist")
    if not os.access(folder, os.W_OK):
        raise RunError(f"{path}: the folder {folder} is not writable")


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear radiance, any shape -> sRGB in [0, 1], clipped (IEC 61966-2-1)."""
    import numpy as np

    x = np.clip(np.nan_to_num(linear, nan=0.0, posinf=1.0), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1 / 2.4) - 0.055)


def write_png(linear: np.ndarray, path: Path) -> None:
    """Linear (3, H, W) -> 8-bit sRGB PNG, whole or absent. Raises RunError if it cannot be written."""
    import numpy as np
    from PIL import Image

    pixels = (to_srgb(linear).transpose(1, 2, 0) * 255 + 0.5).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    write_atomic(path, buffer.getvalue())


def write_image(frame: pave.Frame, path: Path, names: str = "pave", color: str = "color") -> None:
    """Writes `frame` to `path`: .exr takes every channel, .png the channel `color` alone."""
    import pave

    if path.suffix.lower() == ".exr":
        pave.write_exr(frame, str(path), names)
        return
    if color not in frame.channels:
        raise UsageError(f"{path}: a PNG shows the channel '{color}', which was not rendered")
    write_png(frame[color].numpy(), path)
