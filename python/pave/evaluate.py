"""Measures an exported generator on every split, and on scenes it never saw, against the two baselines.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from pave import metrics
from pave.errors import UsageError
from pave.export import ExportedGenerator, load_generator
from pave.files import write_atomic, write_json
from pave.schema import TARGET, Sample

EVALUATION_FILE = "evaluation.json"
IMAGES_FILE = "evaluation.csv"
NOVEL = "novel"

METHODS = ("generated", "direct", "ambient")
MEASURES = ("psnr", "ssim", "l1", "rel_mse")
BASELINE_CHANNELS = ("direct", "albedo")

# A perfect image has no finite PSNR; in means it counts as this many dB.
PSNR_CAP = 100.0


@dataclass
class SplitScores:
    """Means over one split, by method and measure, and each image's own values."""

    name: str
    images: int
    means: dict[str, dict[str, float]]
    per_image: list[dict[str, float]] = field(repr=False)

    @property
    def baseline_psnr(self) -> float | None:
        """The better baseline's; None if the frames hold no channels to make one of."""
        baselines = [values["psnr"] for name, values in self.means.items() if name != "generated"]
        return max(baselines, default=None)

    @property
    def gain(self) -> float | None:
        """dB that the network is above the better baseline, if there is one."""
        best = self.baseline_psnr
        return None if best is None else self.means["generated"]["psnr"] - best

    def to_json(self) -> dict[str, Any]:
        record: dict[str, Any] = {"images": self.images, **self.means}
        if self.gain is not None:
            record["gain_db"] = self.gain
        return record


@dataclass
class Evaluation:
    """Scores of all splits. `ambient` is None if the training split lacks a channel of the baseline."""

    weights_version: str
    ambient: list[float] | None
    splits: dict[str, SplitScores]

    def to_json(self) -> dict[str, Any]:
        return {
            "weights_version": self.weights_version,
            **({} if self.ambient is None else {"ambient": self.ambient}),
            "comparison": "sRGB, clipped to [0, 1]; rel_mse of linear radiance",
            "splits": {name: scores.to_json() for name, scores in self.splits.items()},
        }

    def table(self) -> str:
        """The means as text, a line for each split and method."""
        lines = [f"{'split':<12}{'method':<12}{'PSNR dB':>9}{'SSIM':>9}{'L1':>9}{'relMSE':>10}"]
        for name, scores in self.splits.items():
            for method, values in scores.means.items():
                lines.append(
                    f"{name:<12}{method:<12}{values['psnr']:>9.2f}{values['ssim']:>9.4f}"
                    f"{values['l1']:>9.4f}{values['rel_mse']:>10.4f}"
                )
        return "\n".join(lines)


def draw_all(
    generator: ExportedGenerator, sample: Sample, ambient: Sequence[float] | None
) -> dict[str, torch.Tensor]:
    """The image of each method for one frame, linear radiance; of a baseline only if its channels are there."""
    images = {"generated": generator.draw(sample)}
    if "direct" in sample:
        images["direct"] = sample["direct"]
        if "albedo" in sample and ambient is not None:
            images["ambient"] = metrics.with_ambient(sample, torch.tensor(ambient))
    return images


def score_split(
    generator: ExportedGenerator,
    samples: Sequence[Sample],
    ambient: Sequence[float] | None,
    name: str,
    on_image: Callable[[], Any] | None = None,
) -> SplitScores:
    """Scores of one split. Raises UsageError if it is empty or lacks a channel."""
    if len(samples) == 0:
        raise UsageError(f"the {name} split has no images")
    rows: list[dict[str, float]] = []
    for index in range(len(samples)):
        sample = samples[index]
        if TARGET not in sample:
            raise UsageError(f"the {name} split has no channel '{TARGET}' to compare with")
        row: dict[str, float] = {"image": index}
        for method, image in draw_all(generator, sample, ambient).items():
            for measure, value in metrics.compare(image, sample[TARGET]).items():
                row[f"{method}_{measure}"] = float(value)
            row[f"{method}_psnr"] = min(row[f"{method}_psnr"], PSNR_CAP)
        rows.append(row)
        if on_image is not None:
            on_image()
    means: dict[str, dict[str, float]] = {}
    for method in METHODS:
        if f"{method}_psnr" in rows[0]:
            means[method] = {
                measure: sum(row[f"{method}_{measure}"] for row in rows) / len(rows)
                for measure in MEASURES
            }
    return SplitScores(name, len(rows), means, rows)


def evaluate(
    run: str | Path,
    splits: Mapping[str, Sequence[Sample]],
    *,
    write: bool = True,
    on_progress: Callable[[int, int], Any] | None = None,
) -> Evaluation:
    """Scores of the generator in `run` on each of `splits`; "train" is where the ambient baseline is fitted.

    Samples hold `color` and the network's inputs, and `direct` and `albedo` for the baselines, which are left out where those
    are missing. With `write` the folder gets evaluation.json and, image by image, evaluation.csv. `on_progress(done, total)`
    is called after each image. Raises UsageError for missing splits or channels, or images too small to compare; InputError
    for a damaged run.
    """
    generator = load_generator(run)
    if "train" not in splits:
        raise UsageError("evaluate() fits the ambient baseline on the split 'train': pass it too")
    training = splits["train"]
    baseline = len(training) > 0 and {*BASELINE_CHANNELS, TARGET} <= set(training[0])
    total = sum(len(split) for split in splits.values()) + (len(training) if baseline else 0)
    steps = itertools.count(1)

    def step() -> None:
        if on_progress is not None:
            on_progress(next(steps), total)

    ambient = None
    if baseline:

        def samples() -> Iterator[Sample]:
            for index in range(len(training)):
                yield training[index]
                step()

        ambient = [float(k) for k in metrics.fit_ambient(samples())]
    result = Evaluation(
        generator.weights_version,
        ambient,
        {
            name: score_split(generator, split, ambient, name, step)
            for name, split in splits.items()
        },
    )
    if write:
        _write(Path(run), result)
    return result


def _write(run: Path, result: Evaluation) -> None:
    write_json(run / EVALUATION_FILE, result.to_json())
    table = io.StringIO()
    names = (name for scores in result.splits.values() for name in scores.per_image[0])
    columns = ["split", *dict.fromkeys(names)]
    writer = csv.DictWriter(table, columns, restval="", lineterminator="\n")
    writer.writeheader()
    for name, scores in result.splits.items():
        for row in scores.per_image:
            writer.writerow({"split": name, **row})
    write_atomic(run / IMAGES_FILE, table.getvalue().encode())
