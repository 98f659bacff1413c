"""What a training run leaves for people to follow: metrics.csv, TensorBoard files, the loss figure.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from pave.files import write_atomic

METRICS_FILE = "metrics.csv"
LOSS_FIGURE = "loss.png"
TENSORBOARD_FOLDER = "tensorboard"

Row = dict[str, float]

# Columns of metrics.csv, one row an epoch. The first block are means over the epoch's training steps, in train mode; those with
# val_ are of the validation split, with the averaged weights and everything in eval mode.
COLUMNS = (
    "epoch",
    "step",
    "seconds",
    "lr",
    "g_loss",
    "g_l1",
    "g_adversarial",
    "d_loss",
    "d_real",
    "d_fake",
    "val_psnr",
    "val_ssim",
    "val_l1",
    "val_d_real",
    "val_d_fake",
)


def read_history(folder: Path) -> list[Row]:
    """Rows of metrics.csv; empty if there is none."""
    path = folder / METRICS_FILE
    if not path.exists():
        return []
    with open(path, newline="") as file:
        return [{k: float(v) for k, v in row.items() if v != ""} for row in csv.DictReader(file)]


class RunLog:
    """Follows one run. Rows of epochs after the checkpoint that a run resumes from are taken back."""

    def __init__(self, folder: Path, history: list[Row], figures: bool = True) -> None:
        self.folder, self.history = folder, history
        self.figures = figures
        self._writer: Any = None
        if figures:
            from torch.utils.tensorboard import SummaryWriter

            purge = int(history[-1]["step"]) + 1 if history else 0
            self._writer = SummaryWriter(str(folder / TENSORBOARD_FOLDER), purge_step=purge)

    def add(self, row: Row) -> None:
        """Takes one epoch's row: the table and the event file are up to date on return."""
        self.history.append(row)
        self._write_table()
        if self._writer is not None:
            for name, value in row.items():
                if name not in ("epoch", "step"):
                    group = "validation" if name.startswith("val_") else "train"
                    self._writer.add_scalar(f"{group}/{name}", value, int(row["step"]))
            self._writer.flush()

    def _write_table(self) -> None:
        text = io.StringIO()
        writer = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
        writer.writeheader()
        for row in self.history:
            writer.writerow({key: f"{value:.9g}" for key, value in row.items()})
        write_atomic(self.folder / METRICS_FILE, text.getvalue().encode())

    def close(self) -> None:
        """Draws the loss figure and closes the event file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None
        if self.history and self.figures:
            from pave.plots import loss_figure, to_png

            write_atomic(self.folder / LOSS_FIGURE, to_png(loss_figure(self.history)))
