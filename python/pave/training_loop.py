"""The loop of one training run: epochs, validation, checkpoints, and the state that makes a resumed run the same run.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import contextlib
import json
import math
import platform
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from pave import export, metrics
from pave.checkpoint import load_latest, save_checkpoint
from pave.errors import InputError, RunError, UsageError
from pave.files import hash_bytes, read_bytes, write_json
from pave.interrupts import StopRequest
from pave.losses import probability
from pave.options import TrainOptions
from pave.run_log import Row, RunLog
from pave.samples import Batch, EncodedImages, epoch_order, image_size, mirror_batch
from pave.schema import Sample, fit_schema
from pave.trainer import Trainer

CONFIG_FILE = "config.json"
REPORT_STEPS = 10  # steps between two calls of on_progress
VALIDATION_BATCH = 8
TRIAL_STEPS, TRIAL_SHARE = 30, 0.05  # most steps of the trial, most of the minutes given
PLANNED_SHARE = 0.92  # of the minutes given; the rest is for what a short trial cannot foresee
HARD_LIMIT = 1.3  # times the minutes given: a busy machine should not cut off the end of the learning rate's fall

# Options that may differ when a run is resumed: they do not change its result.
_FREE_OPTIONS = ("checkpoint_steps", "checkpoint_seconds", "cache_bytes", "device")

Progress = Callable[[dict[str, Any]], Any]


def pick_device(name: str) -> torch.device:
    """The torch device of an option. Raises UsageError for CUDA where there is none."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name == "cuda" and not torch.cuda.is_available():
        raise UsageError("device cuda: torch finds no CUDA device; take cpu")
    return torch.device(name)


def holds_run(folder: Path) -> bool:
    """Whether the folder's config.json is one that a run wrote."""
    try:
        config = json.loads((folder / CONFIG_FILE).read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(config, dict) and {"options", "epochs", "data_hash"} <= set(config)


class TrainingRun:
    """One run folder being filled. Resumes when made over a folder with a checkpoint; execute() does the rest."""

    def __init__(
        self,
        data: tuple[Sequence[Sample], Sequence[Sample]],
        folder: Path,
        options: TrainOptions,
        provenance: dict[str, Any],
        on_progress: Progress | None,
        figures: bool,
        stop: StopRequest,
    ) -> None:
        self.stop = stop
        self.seconds = dict.fromkeys(("load", "train", "validate", "checkpoint", "export"), 0.0)
        self.folder, self.options, self.on_progress = folder, options, on_progress
        self.device = pick_device(options.device)
        with self.clock("load"):
            train_samples, validation_samples = data
            self._check_sizes(data)
            self.schema = fit_schema(
                (train_samples[i] for i in range(len(train_samples))),
                options.inputs,
                repeat_depth=options.repeat_depth,
            )
            how = (self.schema, options.cache_bytes)
            multiple = 2**options.unet_depth
            self.images = EncodedImages(train_samples, *how, "training", multiple)
            self.validation = EncodedImages(validation_samples, *how, "validation", multiple)
        state, self.remarks = load_latest(folder)
        self.config = self._agree_on_config(provenance, resuming=state is not None)
        if state is None:
            self._write_config()
        self.epochs = int(self.config["epochs"])
        self.order = self._order(0)
        self.trainer = Trainer(self.schema, options, self.epochs * len(self.order), self.device)
        self.epoch, self.position = 0, 0
        self.sums: dict[str, float] = {}
        self.best: dict[str, Any] | None = None
        self.seconds_before = 0.0
        history: list[Row] = []
        if state is not None:
            history = self._load(state)
        self.resumed_from = self.trainer.step_index
        self.begin = self.saved_at = time.monotonic()
        self.log = RunLog(folder, history, figures)

    @contextlib.contextmanager
    def clock(self, stage: str) -> Iterator[None]:
        """Adds the wall time of its body to `stage`."""
        begin = time.monotonic()
        try:
            yield
        finally:
            self.seconds[stage] += time.monotonic() - begin

    def _check_sizes(self, data: tuple[Sequence[Sample], Sequence[Sample]]) -> None:
        """Raises UsageError for images that no step could be made on."""
        for samples in data:
            if len(samples) == 0:
                continue  # said where it is read
            height, width = image_size(samples)
            metrics.check_size(width, height)
            levels, multiple = self.options.d_layers, 2**self.options.unet_depth
            side = export.padded_side(min(height, width), multiple)
            if self.options.adversarial_weight > 0 and side < 2**levels:
                raise UsageError(
                    f"d_layers {levels} leaves nothing of images of {width}x{height} pixels; "
                    f"{side.bit_length() - 1} is the most"
                )

    @property
    def elapsed(self) -> float:
        """Seconds that this run has taken, over all its sessions."""
        return self.seconds_before + time.monotonic() - self.begin

    def _order(self, epoch: int) -> list[torch.Tensor]:
        return epoch_order(len(self.images), self.options.batch, self.options.seed, epoch)

    # Configuration ---------------------------------------------------------------------------------------------------

    def _agree_on_config(self, provenance: dict[str, Any], resuming: bool) -> dict[str, Any]:
        """The configuration of a new run; for an old one that in config.json, compared with what is asked for."""
        path = self.folder / CONFIG_FILE
        data_hash = _data_hash(self.images)
        if resuming:
            try:
                config = json.loads(read_bytes(path))
                theirs, their_hash, _ = config["options"], config["data_hash"], config["epochs"]
            except (ValueError, KeyError, TypeError) as error:
                raise InputError(f"{path}: not a run's configuration: {error}") from error
            for name, value in self.options.to_json().items():
                if name not in _FREE_OPTIONS and theirs.get(name) != value:
                    raise UsageError(
                        f"{self.folder} holds a run with {name} {theirs.get(name)}, not {value}; "
                        "give the same options to resume it, or another folder"
                    )
            if their_hash != data_hash:
                raise UsageError(f"{self.folder} holds a run on other data; give another folder")
            return config
        config = {
            "options": self.options.to_json(),
            "epochs": self._plan_epochs(),
            "schema": self.schema.to_json(),
            "data_hash": data_hash,
            "images": {"training": len(self.images), "validation": len(self.validation)},
            "size": [self.images.width, self.images.height],
            "provenance": {**provenance, **software()},
        }
        return config

    def _write_config(self) -> None:
        write_json(self.folder / CONFIG_FILE, self.config)

    def _plan_epochs(self) -> int:
        """Epochs that fit into `minutes`, by a short trial. After that the run no longer depends on the clock."""
        if self.options.minutes is None:
            return self.options.epochs
        order = self._order(0)
        trial = Trainer(self.schema, self.options, 1, self.device)
        step_seconds = []
        for count in range(TRIAL_STEPS):
            begin = time.monotonic()
            trial.step(*self._to_device(self.images.batch(order[count % len(order)])))
            _synchronize(self.device)
            step_seconds.append(time.monotonic() - begin)
            if count > 1 and sum(step_seconds) > TRIAL_SHARE * 60 * self.options.minutes:
                break
        # The first ones plan convolutions and fill caches; the median lets a disturbed one go.
        step = statistics.median(step_seconds[len(step_seconds) // 3 :])
        # An image in validation costs about what a third of a training step costs for one: only forward.
        validation = step / self.options.batch / 3 * len(self.validation)
        epoch_seconds = step * len(order) + validation
        return max(1, int(60 * self.options.minutes * PLANNED_SHARE / epoch_seconds))

    # The run ---------------------------------------------------------------------------------------------------------

    def execute(self) -> str:
        """Trains to the end, or until stopped, and exports the best weights. Returns their version."""
        going = True
        self._report()
        while going and self.epoch < self.epochs:
            if self.position == 0 and self._time_is_up():
                self._end_here()
                break
            going = self._train_epoch() and self._finish_epoch()
            self._save()
        if self.best is None:
            raise RunError(
                f"{self.folder}: stopped before the first epoch's end; run it again to go on"
            )
        with self.clock("export"):
            version = self._export()
        return version

    def _time_is_up(self) -> bool:
        """Whether one more epoch, as long as those before, would pass the hard limit."""
        if self.options.minutes is None or self.epoch == 0:
            return False
        return self.elapsed * (1 + 1 / self.epoch) > 60 * self.options.minutes * HARD_LIMIT

    def _end_here(self) -> None:
        """Makes the epochs done all that this run has, so that it is finished for every later call too."""
        self.remarks.append(
            f"{self.folder}: {self.options.minutes:g} minutes were up after {self.epoch} of the "
            f"{self.epochs} epochs planned"
        )
        self.epochs = self.config["epochs"] = self.epoch
        self._write_config()

    def _to_device(self, batch: Batch) -> Batch:
        return batch[0].to(self.device, non_blocking=True), batch[1].to(
            self.device, non_blocking=True
        )

    def _train_epoch(self) -> bool:
        """The rest of the epoch's steps. False if somebody wants to stop: the step at hand is done, the next is not."""
        self.order = self._order(self.epoch)
        batches = self.images.batches(self.order[self.position :])
        mark = time.monotonic()
        for batch in batches:
            if self.options.mirror:
                batch = mirror_batch(*batch, self.schema, self.trainer.step_index)
            losses = self.trainer.step(*self._to_device(batch))
            self.position += 1
            for name, value in losses.items():
                self.sums[name] = self.sums.get(name, 0.0) + float(value)
            if not math.isfinite(float(losses["g_loss"])):
                raise RunError(
                    f"{self.folder}: the loss is not a number after {self.trainer.step_index} steps; "
                    "lower lr and start in another folder (the last checkpoint is kept)"
                )
            due = self.trainer.step_index % REPORT_STEPS == 0
            if (due and not self._report()) or self.stop:
                self.seconds["train"] += time.monotonic() - mark
                return False
            if self._checkpoint_due():
                self.seconds["train"] += time.monotonic() - mark
                self._save()
                mark = time.monotonic()
        self.seconds["train"] += time.monotonic() - mark
        return True

    def _finish_epoch(self) -> bool:
        """Validation, the epoch's row, and whether it is the best so far. False, with nothing changed, if stopped before."""
        with self.clock("validate"):
            scores = self._validate()
        if scores is None:
            return False
        row: Row = {name: total / self.position for name, total in self.sums.items()}
        self.epoch, self.position, self.sums = self.epoch + 1, 0, {}
        row.update(scores)
        row.update(
            epoch=self.epoch,
            step=self.trainer.step_index,
            seconds=self.elapsed,
            lr=self.trainer.rate,
        )
        self.log.add(row)
        sign = -1.0 if self.options.best == "l1" else 1.0
        value = sign * row[f"val_{self.options.best}"]
        if self.best is None or value > self.best["value"]:
            weights = self.trainer.average.network.state_dict()
            self.best = {
                "value": value,
                "row": dict(row),
                "weights": {name: tensor.detach().clone() for name, tensor in weights.items()},
            }
        return self._report() and not self.stop

    @torch.no_grad()
    def _validate(self) -> Row | None:
        """Means over the validation split; None if stopped meanwhile."""
        generator = self.trainer.average.network
        discriminator = self.trainer.discriminator.eval()
        images, sums = self.validation, Row()
        count = len(images)
        indices = list(torch.arange(count).split(VALIDATION_BATCH))
        for batch in images.batches(indices):
            if self.stop:
                return None
            buffers, target = self._to_device(batch)
            fake = generator(buffers)
            ours, truth = (
                self.schema.decode_output(image[..., : images.height, : images.width])
                for image in (fake, target)
            )
            scores = metrics.compare(ours, truth)
            scores["psnr"] = scores["psnr"].clamp_max(100.0)
            values = {f"val_{name}": scores[name].sum() for name in ("psnr", "ssim", "l1")}
            if self.options.adversarial_weight > 0:
                mode = self.options.gan_mode
                for name, image in (("val_d_real", target), ("val_d_fake", fake)):
                    values[name] = probability(discriminator(buffers, image), mode) * len(target)
            for name, value in values.items():
                sums[name] = sums.get(name, 0.0) + float(value) / count
        return sums

    def _report(self) -> bool:
        """Tells the caller where the run is; False if it wants to stop."""
        if self.on_progress is None:
            return True
        done, total = self.trainer.step_index, self.epochs * len(self.order)
        rate = (done - self.resumed_from) / max(time.monotonic() - self.begin, 1e-9)
        record: dict[str, Any] = {
            "epoch": self.epoch,
            "epochs": self.epochs,
            "step": done,
            "steps": total,
            "steps_per_second": rate,
            "eta_seconds": (total - done) / rate if rate > 0 else None,
            "seconds": self.elapsed,
        }
        if self.position:
            record["g_l1"] = self.sums["g_l1"] / self.position
        if self.log.history:
            last = self.log.history[-1]
            record.update({name: last[name] for name in ("val_psnr", "val_ssim", "val_l1")})
        return self.on_progress(record) is not False

    # State -----------------------------------------------------------------------------------------------------------

    def _checkpoint_due(self) -> bool:
        options = self.options
        if options.checkpoint_steps and self.trainer.step_index % options.checkpoint_steps == 0:
            return True
        seconds = options.checkpoint_seconds
        return bool(seconds) and time.monotonic() - self.saved_at >= seconds

    def _save(self) -> None:
        with self.clock("checkpoint"):
            state = {
                "trainer": self.trainer.state(),
                "epoch": self.epoch,
                "position": self.position,
                "sums": self.sums,
                "best": self.best,
                "history": self.log.history,
                "seconds": self.elapsed,
            }
            save_checkpoint(self.folder, state, self.trainer.step_index)
        self.saved_at = time.monotonic()

    def _load(self, state: dict[str, Any]) -> list[Row]:
        self.trainer.load(state["trainer"])
        self.epoch, self.position = state["epoch"], state["position"]
        self.sums, self.best = state["sums"], state["best"]
        self.seconds_before = state["seconds"]
        return list(state["history"])

    def _export(self) -> str:
        assert self.best is not None
        generator = self.trainer.average.network
        generator.load_state_dict(self.best["weights"])
        training = {**self.config, "best": self.best["row"], "steps": self.trainer.step_index}
        training["seconds"] = round(self.elapsed, 3)
        return export.export_generator(self.folder, generator, self.schema, training)


def software() -> dict[str, Any]:
    """Versions of what a run was made with."""
    import pave

    return {
        "program_version": getattr(pave, "__version__", "unknown"),
        "program_commit": pave.commit(),
        "torch": str(torch.__version__),
        "python": platform.python_version(),
        "threads": torch.get_num_threads(),
    }


def _data_hash(images: EncodedImages) -> str:
    """Tells whether a resumed run sees the same images: of all that are in memory, else of the first and the last."""
    if images.cache is not None:
        planes = images.cache
    else:
        planes = images.batch(torch.tensor([0, len(images) - 1]))
    return hash_bytes("".join(hash_bytes(t.permute(0, 2, 3, 1).numpy()) for t in planes).encode())


def _synchronize(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
