"""How much less error has PAVE's image after the time that Mitsuba takes for 64 samples a pixel?

SPDX-License-Identifier: BSD-3-Clause

Squared error is that of linear radiance clipped to [0, 1], against the mean of PAVE's images of many
seeds; the reference's own error, which the difference of its halves tells, is taken off both sides.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pave.bench.common import (
    Bench,
    Figure,
    Mean,
    WrongAnswer,
    median,
    scene_file,
    temporary_folder,
    timed,
)
from pave.bench.subjects import Mitsuba, Pave, independent_mean

SAMPLERS = ("multijitter", "independent", "orthogonal")
SPP = 64
FIRST_SEED = 5000  # of the reference; no measured image has one of its seeds
MAX_REFERENCE_SHARE = 0.25  # of an image's squared error that the reference may add


@dataclass(frozen=True)
class Reference:
    """A converged image, clipped, and the squared error that it still has."""

    image: np.ndarray
    error: float
    mean: Mean

    def squared_error(self, image: np.ndarray) -> float:
        """Raises WrongAnswer where the reference is too coarse to say."""
        raw = float(np.mean((np.clip(image, 0, 1) - self.image) ** 2, dtype=np.float64))
        if self.error > MAX_REFERENCE_SHARE * raw:
            raise WrongAnswer(
                f"the reference's own error {self.error:.2g} is too large beside {raw:.2g}: no number"
            )
        return raw - self.error


def make_reference(bench: Bench, own: Pave, images: int, spp: int) -> Reference:
    halves = np.zeros((2, *own.frame["color"].shape))
    means = []
    for number in range(images):
        bench.note(f"reference, image {number + 1} of {images}")
        color = own.render(spp, FIRST_SEED + number).astype(np.float64)
        halves[number % 2] += color / (images / 2)
        means.append(color.mean((1, 2)))
    low, high = (np.clip(half, 0, 1) for half in halves)
    mean = Mean(np.mean(means, 0), np.std(means, 0, ddof=1) / np.sqrt(images))
    error = float(np.mean((low - high) ** 2)) / 4
    return Reference(np.clip(halves.mean(0), 0, 1), error, mean)


def check_blocks(image: np.ndarray, runs: np.ndarray, blocks: int = 4) -> None:
    """The reference and Mitsuba's images agree in each of blocks x blocks parts of the view."""
    side = image.shape[1] // blocks
    for row in range(blocks):
        for column in range(blocks):
            part = np.s_[:, row * side : (row + 1) * side, column * side : (column + 1) * side]
            exact = image[part].mean((1, 2))
            peer = Mean.of_runs([np.clip(run, 0, 1)[part] for run in runs])
            # The clipped mean of few samples is biased at pixels near 1: only darker parts compare.
            if image[part].max() < 0.8 and not np.all(
                np.abs(exact - peer.values) <= 6 * peer.errors + 1e-5
            ):
                raise WrongAnswer(
                    f"equal-time: wrong answer, no number: in block {row},{column} the reference "
                    f"is {exact}, Mitsuba's mean {peer.values} +- {peer.errors}"
                )


def run(bench: Bench) -> None:
    quick = bench.options.quick
    size, images, spp = (16, 4, 4096) if quick else (256, 16, 4096)
    mitsuba = Mitsuba.find(bench)
    path = scene_file("cornell")
    own = Pave(bench.device, path, size, ("color",))
    reference = make_reference(bench, own, images, spp)
    independent_mean(bench.device, path, size, SPP).check(reference.mean, "reference")
    if mitsuba is None:
        return alone(bench, own, reference)
    scene = mitsuba.load(path, size, SPP)
    bench.note("validating")
    runs = [mitsuba.render(scene, 4 * SPP, 2000 + seed) for seed in range(8)]
    Mean.of_runs(runs).check(reference.mean, "equal-time: Mitsuba and reference")
    check_blocks(reference.image, np.asarray(runs))
    with temporary_folder() as folder:
        for sampler in SAMPLERS[:1] if quick else SAMPLERS:
            file = with_sampler(path, sampler, Path(folder))
            compare(bench, own, reference, mitsuba, (sampler, mitsuba.load(file, size, SPP)))


def with_sampler(path: Path, sampler: str, folder: Path) -> Path:
    """The scene file with another sampler."""
    file = folder / f"{sampler}.xml"
    shutil.copy(path, file)
    file.write_text(path.read_text().replace('"independent"', f'"{sampler}"'))
    return file


@dataclass
class Series:
    """Seconds and squared errors of one side, a round each."""

    seconds: list[float]
    errors: list[float]

    def add(self, reference: Reference, work: Callable[[], np.ndarray], keep: bool) -> float:
        """Seconds of one round, which is kept or dropped."""
        image: list[Any] = []
        spent = timed(lambda: image.append(work()))
        if keep:
            self.seconds.append(spent)
            self.errors.append(reference.squared_error(image[0]))
        return spent


def alone(bench: Bench, own: Pave, reference: Reference) -> None:
    """Without a peer: the error and the time of 64 samples."""
    mine = Series([], [])
    for number in range(bench.rounds() + 1):
        bench.note(f"PAVE, round {number} of {bench.rounds()}")
        mine.add(reference, lambda number=number: own.render(SPP, number), number > 0)
    more = {"seconds": median(mine.seconds), "spp": SPP, "reference_error": reference.error}
    figure = Figure("64-samples", "squared_error", "", mine.errors, higher_is_better=False)
    bench.report(with_more(figure, reference, more))


def with_more(figure: Figure, reference: Reference, more: dict[str, Any]) -> Figure:
    figure.mean, figure.more = reference.mean, more
    return figure


def compare(
    bench: Bench, own: Pave, reference: Reference, mitsuba: Mitsuba, peer: tuple[str, Any]
) -> None:
    """Rounds of both in turn; PAVE's samples are those that fitted the peer's time so far."""
    sampler, scene = peer
    mine, theirs = Series([], []), Series([], [])
    mitsuba.render(scene, SPP, 999)  # compiles
    spp, counts = 4 * SPP, []
    for number in range(bench.rounds() + 1):
        bench.note(f"{sampler}: round {number} of {bench.rounds()}")
        keep = number > 0
        peer_s = theirs.add(reference, lambda seed=number: mitsuba.render(scene, SPP, seed), keep)
        own_s = mine.add(reference, lambda seed=number, spp=spp: own.render(spp, seed), keep)
        counts.append(spp)
        spp = max(int(spp * median([peer_s, *theirs.seconds]) / own_s), 1)
    # What a round of PAVE took too long is charged to it, what it took less is not.
    overtime = [max(own / peer, 1) for own, peer in zip(mine.seconds, theirs.seconds, strict=True)]
    charged = [error * over for error, over in zip(mine.errors, overtime, strict=True)]
    more = {
        "seconds": median(theirs.seconds),
        "own_seconds": median(mine.seconds),
        "spp": median(counts[1:]),
        "reference_error": reference.error,
    }
    name = f"mitsuba llvm_ad_rgb {sampler}"
    figure = Figure(sampler, "squared_error", "", charged, name, theirs.errors, False)
    bench.report(with_more(figure, reference, more))
