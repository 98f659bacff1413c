"""Measures an exported generator on every split, and on scenes it never saw, against the two baselines.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from pave import metrics
from pave.errors import UsageError
from pave.export import ExportedGenerator, load_generator
from pave.files import write_atomic
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
    def baseline_psnr(self) -> float:
        """The better baseline's."""
        return max(values["psnr"] for method, values in self.means.items() if method != "generated")

    @property
    def gain(self) -> float:
        """dB that the network is above the better baseline."""
        return self.means["generated"]["psnr"] - self.baseline_psnr

    def to_json(self) -> dict[str, Any]:
        return {"images": self.images, **self.means, "gain_db": self.gain}


@dataclass
class Evaluation:
    """Scores of all splits."""

    weights_version: str
    ambient: list[float]
    splits: dict[str, SplitScores]

    def to_json(self) -> dict[str, Any]:
        return {
            "weights_version": self.weights_version,
            "ambient": self.ambient,
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
    generator: ExportedGenerator, sample: Sample, ambient: torch.Tensor
) -> dict[str, torch.Tensor]:
    """The image of each method for one frame, linear radiance."""
    images = {"generated": generator.draw(sample)}
    if all(name in sample for name in BASELINE_CHANNELS):
        images["direct"] = sample["direct"]
        images["ambient"] = metrics.with_ambient(sample, ambient)
    return images


def score_split(
    generator: ExportedGenerator, samples: Sequence[Sample], ambient: torch.Tensor, name: str
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
) -> Evaluation:
    """Scores of the generator in `run` on each of `splits`; "train" is where the ambient baseline is fitted.

    Samples hold `color`, `direct`, `albedo` and the network's inputs. With `write` the folder gets evaluation.json and, image
    by image, evaluation.csv. Raises UsageError for missing splits or channels, InputError for a damaged run.
    """
    generator = load_generator(run)
    if "train" not in splits:
        raise UsageError("evaluate() fits the ambient baseline on the split 'train': pass it too")
    training = splits["train"]
    have = set(training[0]) if len(training) else set()
    ambient = torch.zeros(3)
    if set(BASELINE_CHANNELS) <= have:
        ambient = metrics.fit_ambient(training[i] for i in range(len(training)))
    result = Evaluation(
        generator.weights_version,
        [float(k) for k in ambient],
        {name: score_split(generator, split, ambient, name) for name, split in splits.items()},
    )
    if write:
        _write(Path(run), result)
    return result


def _write(run: Path, result: Evaluation) -> None:
    text = json.dumps(result.to_json(), indent=1) + "\n"
    write_atomic(run / EVALUATION_FILE, text.encode())
    table = io.StringIO()
    columns = ["split", *next(iter(result.splits.values())).per_image[0]]
    writer = csv.DictWriter(table, columns, restval="", lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    for name, scores in result.splits.items():
        for row in scores.per_image:
            writer.writerow({"split": name, **row})
    write_atomic(run / IMAGES_FILE, table.getvalue().encode())
