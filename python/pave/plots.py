"""Figures: the papers' loss curves and comparison images, drawn with matplotlib off screen.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure

from pave.transfer import to_display

# Okabe and Ito's palette: tells apart for all kinds of colour vision, on white and on black.
BLUE, ORANGE, GREEN, PURPLE, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#7f7f7f"

Row = dict[str, float]
Series = Sequence[tuple[str, str, str, str]]  # column, label, colour, line style

LOSSES: Series = (
    ("g_l1", "generator, L1", BLUE, "-"),
    ("val_l1", "generator, L1 on validation", BLUE, "--"),
    ("g_adversarial", "generator, adversarial", GREEN, "-"),
    ("d_loss", "discriminator", ORANGE, "-"),
)
VERDICTS: Series = (
    ("val_d_real", "path traced", ORANGE, "-"),
    ("val_d_fake", "generated", BLUE, "-"),
)
QUALITY: Series = (("val_psnr", "PSNR", BLUE, "-"),)


def _figure(width: float, height: float) -> Figure:
    # Figure without pyplot: no global state, no display.
    return Figure(figsize=(width, height), dpi=100, layout="constrained")


def _draw(axes: Any, history: Sequence[Row], series: Series) -> None:
    for column, label, colour, style in series:
        points = [(row["epoch"], row[column]) for row in history if column in row]
        if points:
            x, y = zip(*points, strict=True)
            marker = "o" if len(points) == 1 else None
            axes.plot(
                x, y, color=colour, linestyle=style, label=label, linewidth=1.6, marker=marker
            )
    axes.grid(True, color=GREY, alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("epoch")


def loss_figure(history: Sequence[Row]) -> Figure:
    """The papers' figure 6: losses of both networks, D's mean outputs, and PSNR, over epochs."""
    figure = _figure(11, 3.4)
    losses, verdicts, quality = figure.subplots(1, 3)
    _draw(losses, history, LOSSES)
    losses.set_yscale("log")
    losses.set_title("Losses", loc="left", fontsize=11)
    losses.legend(fontsize=8, frameon=False)
    _draw(verdicts, history, VERDICTS)
    verdicts.axhline(0.5, color=GREY, linewidth=1, linestyle=":")
    verdicts.set_ylim(0, 1)
    verdicts.set_title("Mean verdict of the discriminator", loc="left", fontsize=11)
    if verdicts.get_legend_handles_labels()[0]:
        verdicts.legend(fontsize=8, frameon=False)
    _draw(quality, history, QUALITY)
    quality.set_title("PSNR on validation, dB", loc="left", fontsize=11)
    return figure


def overview_figure(rows: Sequence[tuple[str, Sequence[tuple[str, np.ndarray]]]]) -> Figure:
    """One row of pictures a view: (name of the view, [(caption, (H, W, 3) bytes), ..])."""
    columns = max(len(pictures) for _, pictures in rows)
    height, width = rows[0][1][0][1].shape[:2]
    figure = _figure(2.0 * columns, (2.0 * height / width + 0.32) * len(rows))
    for axes_row, (name, pictures) in zip(
        figure.subplots(len(rows), columns, squeeze=False), rows, strict=True
    ):
        for axes, (caption, pixels) in zip(axes_row, pictures, strict=True):
            axes.imshow(pixels, interpolation="bilinear")
            axes.set_title(caption, fontsize=9)
            axes.set_xticks([])
            axes.set_yticks([])
            axes.spines[:].set_visible(False)
        axes_row[0].set_ylabel(name, fontsize=9)
    return figure


def to_png(figure: Figure) -> bytes:
    """The figure as PNG, on white."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", facecolor="white")
    return buffer.getvalue()


def display_pixels(linear: torch.Tensor) -> np.ndarray:
    """(3, H, W) linear radiance -> (H, W, 3) bytes, sRGB."""
    return _bytes(to_display(torch.nan_to_num(linear, nan=0.0, posinf=1.0)))


def channel_pixels(channel: str, planes: torch.Tensor) -> np.ndarray:
    """Any channel as a picture, (H, W, 3) bytes; for people, not for data."""
    if channel == "normal":
        lit = planes.abs().sum(0, keepdim=True) > 0
        return _bytes((planes * 0.5 + 0.5) * lit)
    if channel in ("depth", "distance"):
        finite = planes[torch.isfinite(planes)]
        if not finite.numel():
            return _bytes(torch.zeros_like(planes).expand(3, -1, -1))
        near, far = finite.min(), finite.max()
        shade = 1 - 0.85 * (planes - near) / (far - near).clamp_min(1e-9)
        return _bytes(torch.where(torch.isfinite(planes), shade, 0.0).expand(3, -1, -1))
    if channel == "position":
        flat = planes.flatten(1)
        low, high = flat.amin(1).view(3, 1, 1), flat.amax(1).view(3, 1, 1)
        return _bytes((planes - low) / (high - low).clamp_min(1e-9))
    return display_pixels(planes)


def difference_pixels(ours: torch.Tensor, truth: torch.Tensor, gain: float) -> np.ndarray:
    """Absolute difference of the displayed images times `gain`, mean over colours, in a dark to bright scale."""
    error = (to_display(ours) - to_display(truth)).abs().mean(0) * gain
    return _colour_map()[(error.clamp(0, 1) * 255).round().long().numpy()]


def _colour_map() -> np.ndarray:
    import matplotlib

    table = matplotlib.colormaps["inferno"](np.linspace(0, 1, 256))[:, :3]
    return (table * 255 + 0.5).astype(np.uint8)


def _bytes(display: torch.Tensor) -> np.ndarray:
    clipped = display.clamp(0, 1).permute(1, 2, 0)
    return (clipped * 255 + 0.5).to(torch.uint8).contiguous().numpy()


def image_png(pixels: np.ndarray) -> bytes:
    """(H, W, 3) bytes -> PNG."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()
