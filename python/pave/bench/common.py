"""What every bench shares: options, interleaved rounds, medians, lines, and what a wrong answer does.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import pave
from pave.console import Console
from pave.errors import RunError

MAX_DEVIATIONS = 4.0  # by how many standard errors two means may differ


class WrongAnswer(RunError):
    """What was to be timed is wrong: no number is printed and the program ends with 1."""


@dataclass(frozen=True)
class Options:
    """What the command line asks of a bench."""

    peers: bool = False
    quick: bool = False  # tiny images: a check that all works, no figures to keep
    rounds: int | None = None  # that count, after one that is dropped; None: the bench's own
    device: str = ""


@dataclass(frozen=True)
class Mean:
    """Means of an image's channels and their standard errors."""

    values: np.ndarray
    errors: np.ndarray

    @classmethod
    def of_variance(cls, image: np.ndarray, variance: np.ndarray) -> Mean:
        """Of a (C, H, W) image whose pixels are independent, with the variance of each."""
        pixels = image.shape[1] * image.shape[2]
        errors = np.sqrt(variance.sum((1, 2), dtype=np.float64)) / pixels
        return cls(image.mean((1, 2), dtype=np.float64), errors)

    @classmethod
    def of_runs(cls, images: Sequence[np.ndarray]) -> Mean:
        """Of independent (C, H, W) images."""
        stack = np.asarray(images, dtype=np.float64)
        return cls.of_variance(stack.mean(0), stack.var(0, ddof=1) / len(images))

    @property
    def value(self) -> float:
        """Over all channels."""
        return float(self.values.mean())

    @property
    def error(self) -> float:
        """A bound: channels of one path tracer go up and down together."""
        return float(self.errors.mean())

    def check(self, other: Mean, what: str) -> None:
        """Raises WrongAnswer if the two differ by more than MAX_DEVIATIONS standard errors."""
        limit = MAX_DEVIATIONS * np.hypot(self.errors, other.errors) + 1e-6
        off = np.abs(self.values - other.values)
        if not (self.value > 0 and np.all(off <= limit)):
            raise WrongAnswer(
                f"{what}: wrong answer, no number: means {_text(self.values)} and "
                f"{_text(other.values)} differ by more than {_text(limit)}"
            )


def _text(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in np.atleast_1d(values)) + ")"


@dataclass
class Figure:
    """One measured number with its rounds; `peer` None where no peer ran."""

    case: str
    metric: str
    unit: str
    own: Sequence[float]
    peer: str | None = None
    theirs: Sequence[float] | None = None
    higher_is_better: bool = True
    mean: Mean | None = None
    more: dict[str, Any] = field(default_factory=dict)

    def record(self) -> dict[str, Any]:
        value, peer_value, ratio = median(self.own), None, None
        if self.theirs is not None:
            peer_value = median(self.theirs)
            ratio = value / peer_value if self.higher_is_better else peer_value / value
        return {
            "case": self.case,
            "metric": self.metric,
            "value": value,
            "unit": self.unit,
            "peer": self.peer if self.theirs is not None else None,
            "peer_value": peer_value,
            "ratio": ratio,
            "n": len(self.own),
            "spread": spread(self.own),
            "mean": self.mean.value if self.mean else None,
            "mean_error": self.mean.error if self.mean else None,
            **self.more,
        }


class Bench:
    """One run of one bench: its options, its device, and where its lines go."""

    def __init__(self, name: str, console: Console, options: Options) -> None:
        self.name, self.console, self.options = name, console, options
        self.device = pave.Device(options.device)
        self.records: list[dict[str, Any]] = []

    def rounds(self, usual: int = 5) -> int:
        """What was asked for, else `usual`; at most two of a quick bench."""
        return self.options.rounds or (min(usual, 2) if self.options.quick else usual)

    def note(self, text: str) -> None:
        """Where it is: one line that rewrites itself on a terminal, a line each in a pipe."""
        if sys.stderr.isatty():
            print(f"\r\x1b[K{self.name}: {text}", end="", file=sys.stderr, flush=True)
        else:
            self.console.say(f"{self.name}: {text}")

    def remark(self, text: str) -> None:
        """A line that stays."""
        self.clear()
        self.console.say(f"{self.name}: {text}")

    def clear(self) -> None:
        """Takes the progress line away."""
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def report(self, figure: Figure) -> None:
        self.add(figure.record())

    def add(self, record: dict[str, Any]) -> None:
        """One result: printed at once as JSON, else kept for the table."""
        profile = self.device.profile
        place = {"device": profile.name, "driver": profile.driver, "commit": pave.commit()}
        line = {**dict.fromkeys(KEYS), "bench": self.name, **place, **record}
        self.clear()
        self.records.append(line)
        self.console.event(line)

    def interleaved(
        self, case: str, subjects: Mapping[str, Callable[[int], Any]], rounds: int | None = None
    ) -> dict[str, list[float]]:
        """Seconds of each subject by round: all run once a round, in turn; the first round is dropped.

        A subject is called with the round's number, from 0.
        """
        rounds = rounds or self.rounds()
        seconds: dict[str, list[float]] = {name: [] for name in subjects}
        for number in range(rounds + 1):
            for name, work in subjects.items():
                if number == 0 or sys.stderr.isatty():
                    self.note(f"{case}: {name}, round {number} of {rounds}")
                spent = timed(lambda work=work, number=number: work(number))
                if number > 0:
                    seconds[name].append(spent)
        return seconds


KEYS = (
    "bench",
    "case",
    "metric",
    "value",
    "unit",
    "peer",
    "peer_value",
    "ratio",
    "device",
    "driver",
    "commit",
    "n",
    "spread",
    "mean",
    "mean_error",
)


def timed(work: Callable[[], Any]) -> float:
    """Seconds on the wall."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def median(values: Sequence[float]) -> float:
    return float(np.median(values))


def spread(values: Sequence[float]) -> float:
    """Distance of the quartiles over the median."""
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
    return float((high - low) / middle) if middle else 0.0


def temporary_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder that goes with its with-block, also after Ctrl-C."""
    return tempfile.TemporaryDirectory(prefix="pave-bench-")


def scene_file(name: str) -> Path:
    """The XML file of one of PAVE's own scenes, which a peer reads too. Raises RunError."""
    here = Path(pave.__file__).resolve().parent
    folders = [Path(os.environ.get("PAVE_SCENE_DIR") or here / "scenes")]
    folders += [here / "scenes", here.parents[1] / "scenes"]
    for folder in folders:
        if (folder / f"{name}.xml").is_file():
            return folder / f"{name}.xml"
    raise RunError(f"scene {name}.xml was not found in {folders[0]}; set PAVE_SCENE_DIR")
