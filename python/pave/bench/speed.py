"""Paths a second through one scene file, beside Mitsuba on the same file.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pave.bench.common import Bench, Figure, Mean
from pave.bench.subjects import MITSUBA, Mitsuba, Pave, independent_mean


@dataclass(frozen=True)
class Job:
    """A scene file and how it is rendered; depth and roulette are the file's."""

    case: str
    path: Path
    size: int = 256
    spp: int = 64
    channels: Sequence[str] = ("color",)


def measure(bench: Bench, mitsuba: Mitsuba | None, job: Job) -> None:
    """Validates, times, reports the median of paths a second."""
    bench.note(f"{job.case}: validating")
    mean = independent_mean(bench.device, job.path, job.size, 4 * job.spp)
    own = Pave(bench.device, job.path, job.size, job.channels)
    subjects = {"PAVE": lambda seed: own.render(job.spp, seed)}
    check_timed(own, job, mean)
    if mitsuba is not None:
        scene = mitsuba.load(job.path, job.size, job.spp)
        mean.check(mitsuba.mean(scene, job.spp), f"{job.case}: PAVE and Mitsuba")
        subjects["Mitsuba"] = lambda seed: mitsuba.render(scene, job.spp, seed)
    seconds = bench.interleaved(job.case, subjects)
    paths = job.size * job.size * job.spp
    rates = {name: [paths / spent for spent in values] for name, values in seconds.items()}
    bench.report(
        Figure(
            job.case,
            "paths_per_second",
            "paths/s",
            rates["PAVE"],
            MITSUBA,
            rates.get("Mitsuba"),
            mean=mean,
        )
    )


def check_timed(own: Pave, job: Job, mean: Mean) -> None:
    """The render that is timed has the mean of independent samples, which are four times as many.

    Its own error is at most that of as many independent samples.
    """
    image = own.render(job.spp, 1001)
    Mean(image.mean((1, 2), dtype="float64"), 2 * mean.errors).check(
        mean, f"{job.case}: default and independent sampler"
    )
