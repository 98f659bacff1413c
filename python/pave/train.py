"""Trains the conditional GAN on rendered frames, resumes where it was, and exports the best generator.

SPDX-License-Identifier: BSD-3-Clause

A run folder holds config.json, metrics.csv, loss.png, tensorboard/, checkpoints/, and at the end generator.safetensors,
generator.json and run-manifest.json. The same options, data and machine give the same weights, killed and resumed or not.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from pave.checkpoint import FOLDER as CHECKPOINTS
from pave.checkpoint import list_checkpoints
from pave.errors import UsageError
from pave.files import make_folder, remove_stale
from pave.interrupts import StopRequest
from pave.options import TrainOptions
from pave.run_log import Row
from pave.schema import TARGET, Sample
from pave.training_loop import Progress, TrainingRun, holds_run


@dataclass
class TrainResult:
    """What a run came to. `seconds` is wall time by stage; `finished` is False if it was stopped before its last epoch,
    `interrupted` True if a signal asked for that, in time or too late."""

    folder: Path
    epochs: int
    steps: int
    best: Row
    history: list[Row]
    seconds: dict[str, float]
    weights_version: str
    resumed_from: int
    finished: bool
    interrupted: bool = False
    remarks: list[str] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        return {
            "run": str(self.folder),
            "epochs": self.epochs,
            "steps": self.steps,
            "best_epoch": int(self.best["epoch"]),
            "validation_psnr": self.best["val_psnr"],
            "validation_ssim": self.best["val_ssim"],
            "d_real": self.best.get("val_d_real"),
            "d_fake": self.best.get("val_d_fake"),
            "seconds": self.seconds,
            "weights_version": self.weights_version,
            "resumed_from": self.resumed_from,
            "finished": self.finished,
        }


def load_splits(
    uri: str, channels: Sequence[str]
) -> tuple[Sequence[Sample], Sequence[Sample], Sequence[Sample]]:
    """(train, test, validation) of a data set by its URI, 60/20/20."""
    import pave

    loader = pave.DataLoader(uri)
    loader.open(list(channels))
    return loader.get_split()


def train(
    data: str | tuple[Sequence[Sample], Sequence[Sample]],
    folder: str | Path,
    options: TrainOptions | None = None,
    *,
    provenance: dict[str, Any] | None = None,
    on_progress: Progress | None = None,
    figures: bool = True,
    catch_signals: bool = False,
) -> TrainResult:
    """Trains on `data`, a data set's URI or its (train, validation) splits, into `folder`.

    Goes on from the folder's last checkpoint if there is one. `provenance` is any JSON about the data and is kept with the
    weights. Without `figures` the TensorBoard files and loss.png are left out. `on_progress(record)` is called at the start
    and every few steps; if it returns False the run stops after a checkpoint. With `catch_signals` so does the first SIGINT
    or SIGTERM once training has begun, after the step at hand; a second one ends the process. The best weights so far are
    exported in any case.

    Raises UsageError if the folder holds a run of other options or data, or something else; InputError for broken data;
    RunError if the run cannot go on, or was stopped before there were weights to export.
    """
    options = options or TrainOptions()
    options.check()
    if isinstance(data, str):
        provenance = {"dataset": data, **(provenance or {})}
        splits = load_splits(data, [*options.inputs, TARGET])
        data = splits[0], splits[2]
    folder = Path(folder)
    _open_folder(folder)
    stop = StopRequest()
    with torch_settings(options):
        run = TrainingRun(data, folder, options, provenance or {}, on_progress, figures, stop)
        try:
            with stop if catch_signals else contextlib.nullcontext():
                version = run.execute()
        finally:
            run.log.close()
    assert run.best is not None
    return TrainResult(
        folder=folder,
        epochs=run.epoch,
        steps=run.trainer.step_index,
        best=run.best["row"],
        history=run.log.history,
        seconds=dict(run.seconds),
        weights_version=version,
        resumed_from=run.resumed_from,
        finished=run.epoch >= run.epochs,
        interrupted=bool(stop),
        remarks=run.remarks,
    )


def _open_folder(folder: Path) -> None:
    """Makes the run folder, or looks whether what is there may be added to."""
    for each in (folder, folder / CHECKPOINTS):
        remove_stale(each)
    if (
        folder.is_dir()
        and any(folder.iterdir())
        and not (holds_run(folder) or list_checkpoints(folder))
    ):
        raise UsageError(f"{folder} is not empty and holds no training run; name another folder")
    make_folder(folder)


@contextlib.contextmanager
def torch_settings(options: TrainOptions) -> Iterator[None]:
    """Threads and determinism for one run; the process's own settings come back afterwards."""
    threads = torch.get_num_threads()
    deterministic = torch.are_deterministic_algorithms_enabled()
    rng = torch.get_rng_state()
    if options.threads:
        torch.set_num_threads(options.threads)
    if options.deterministic:
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # cuBLAS asks for it
    torch.use_deterministic_algorithms(options.deterministic)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(deterministic)
        torch.set_rng_state(rng)
