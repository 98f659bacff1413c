"""Training and evaluation as the command line and the demo show them: a bar with ETA, then one record.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pave.console import Console
from pave.errors import RunError, UsageError

if TYPE_CHECKING:
    from pave.evaluate import Evaluation
    from pave.schema import Sample


def run_training(
    console: Console,
    uri: str,
    folder: Path,
    options: dict[str, Any],
    provenance: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Trains on the data set `uri` into `folder`; goes on if a checkpoint is there.

    `options` are fields of pave.options.TrainOptions. Raises what pave.train.train raises, and RunError if Ctrl-C or SIGTERM
    stopped the run: a checkpoint and the best weights so far are in the folder then.
    """
    from pave.options import TrainOptions
    from pave.train import train

    checked = TrainOptions.from_json(options)
    console.say("train: reading the data set")
    with console.progress("train", 1, "steps") as bar:

        def on_progress(record: dict[str, Any]) -> bool:
            bar.total = record["steps"]
            note = f"epoch {record['epoch']}/{record['epochs']}"
            if "val_psnr" in record:
                note += f"  validation {record['val_psnr']:.2f} dB, SSIM {record['val_ssim']:.4f}"
            bar.update(record["step"], note)
            console.event({"stage": "train", **record})
            return True

        result = train(
            uri, folder, checked, provenance=provenance, on_progress=on_progress, catch_signals=True
        )
    console.warn(result.remarks)
    if result.interrupted:
        raise RunError(
            f"{folder}: interrupted after step {result.steps}; run the same command again to go on"
        )
    return result.to_json()


def run_evaluation(
    console: Console, folder: Path, uri: str, novel: str | None = None
) -> dict[str, Any]:
    """Scores of the run in `folder` on every split of `uri`, and on all frames of `novel`.

    Writes evaluation.json and evaluation.csv into the folder. Raises what pave.evaluate.evaluate raises, and UsageError if
    `uri` cannot be the data set that the run was trained on.
    """
    import pave
    from pave.evaluate import NOVEL
    from pave.export import load_generator

    generator = load_generator(folder)
    loader = pave.DataLoader(uri)
    loader.open(_channels(uri, generator.schema.channels))
    train, test, validation = loader.get_split()
    trained_on = generator.training.get("images", {})
    for name, split in (("training", train), ("validation", validation)):
        if trained_on.get(name, len(split)) != len(split):
            raise UsageError(
                f"{uri} gives {len(split)} {name} images, the run {folder} had {trained_on[name]}: it is not the data set "
                f"that it was trained on; name that one, and another by --novel {uri}"
            )
    splits = {"train": train, "validation": validation, "test": test}
    if novel is not None:
        splits[NOVEL] = pave.Dataset(novel, _channels(novel, generator.schema.channels))
    result = evaluate_splits(console, folder, splits)
    console.say(result.table())
    return result.to_json()


def _channels(uri: str, inputs: Sequence[str]) -> list[str]:
    """What an evaluation reads of a data set: inputs, target, and the baselines' channels where they are there."""
    import pave
    from pave.evaluate import BASELINE_CHANNELS
    from pave.schema import TARGET

    there = pave.Source(uri).channels
    baselines = [name for name in BASELINE_CHANNELS if name in there]
    return list(dict.fromkeys([*inputs, *baselines, TARGET]))


def evaluate_splits(
    console: Console, folder: Path, splits: Mapping[str, Sequence[Sample]]
) -> Evaluation:
    """evaluate() with a bar and events."""
    from pave.evaluate import evaluate

    with console.counted("evaluate", "images") as step:
        return evaluate(folder, splits, on_progress=step)
