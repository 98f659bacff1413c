"""Paths a second through one scene file, beside the peers on the same file.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pave.bench.common import Bench, Figure, Mean
from pave.bench.cycles import Cycles
from pave.bench.subjects import Mitsuba, Pave, independent_mean


@dataclass(frozen=True)
class Job:
    """A scene file and how it is rendered; depth and roulette are the file's."""

    case: str
    path: Path
    size: int = 256
    spp: int = 64
    channels: Sequence[str] = ("color",)


@contextmanager
def found_peers(bench: Bench) -> Iterator[list[Mitsuba | Cycles]]:
    """Those that were asked for and are there; gone when the with-block ends."""
    mitsuba, cycles = Mitsuba.find(bench), Cycles.find(bench)
    try:
        yield [peer for peer in (mitsuba, cycles) if peer is not None]
    finally:
        if cycles is not None:
            cycles.close()


def measure(bench: Bench, peers: Sequence[Mitsuba | Cycles], job: Job) -> None:
    """Validates, times, reports the median of paths a second: a line for each peer."""
    bench.note(f"{job.case}: validating")
    mean = independent_mean(bench.device, job.path, job.size, 4 * job.spp)
    own = Pave(bench.device, job.path, job.size, job.channels)
    subjects = {"PAVE": lambda seed: own.render(job.spp, seed)}
    check_timed(own, job, mean)
    for peer in peers:
        scene = peer.load(job.path, job.size, job.spp)
        mean.check(peer.mean(scene, job.spp), f"{job.case}: PAVE and {peer.name}")
        subjects[peer.name] = lambda seed, peer=peer, scene=scene: peer.render(scene, job.spp, seed)
    seconds = bench.interleaved(job.case, subjects)
    paths = job.size * job.size * job.spp
    rates = {name: [paths / spent for spent in values] for name, values in seconds.items()}
    for peer in peers or (None,):
        label, theirs = (peer.label, rates[peer.name]) if peer else (None, None)
        figure = Figure(
            job.case, "paths_per_second", "paths/s", rates["PAVE"], label, theirs, mean=mean
        )
        bench.report(figure)


def check_timed(own: Pave, job: Job, mean: Mean) -> None:
    """The render that is timed has the mean of independent samples, which are four times as many.

    Its own error is at most that of as many independent samples.
    """
    image = own.render(job.spp, 1001)
    Mean(image.mean((1, 2), dtype="float64"), 2 * mean.errors).check(
        mean, f"{job.case}: default and independent sampler"
    )
