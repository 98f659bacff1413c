"""Training and evaluation as the command line and the demo show them: a bar with ETA, then one record.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pave.console import Console


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
    from pave.errors import RunError
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
    for remark in result.remarks:
        console.say(f"pave: warning: {remark}")
    if not result.finished:
        raise RunError(
            f"{folder}: interrupted after step {result.steps}; run the same command again to go on"
        )
    return result.to_json()


def run_evaluation(
    console: Console, folder: Path, uri: str, novel: str | None = None
) -> dict[str, Any]:
    """Scores of the run in `folder` on every split of `uri`, and on all frames of `novel`.

    Writes evaluation.json and evaluation.csv into the folder. Raises what pave.evaluate.evaluate raises.
    """
    import pave
    from pave.evaluate import BASELINE_CHANNELS, evaluate
    from pave.export import load_generator
    from pave.schema import TARGET

    inputs = load_generator(folder).schema.channels
    channels = list(dict.fromkeys([*inputs, *BASELINE_CHANNELS, TARGET]))
    loader = pave.DataLoader(uri)
    loader.open(channels)
    train, test, validation = loader.get_split()
    splits = {"train": train, "validation": validation, "test": test}
    if novel is not None:
        splits["novel"] = pave.Dataset(novel, channels)
    result = evaluate(folder, splits)
    console.say(result.table())
    return result.to_json()
