"""How many training views a second go to EXR files with all buffers, and how long take the papers' 3080?

SPDX-License-Identifier: BSD-3-Clause

PAVE makes them as `pave dataset SCENE exr:DIR` does, until all is durable. Mitsuba renders the same
views by its `aov` integrator (albedo, normal, depth and the path traced image) and writes one EXR
file each, the first ones, as many as fit a time. Views differ in cost by up to three times, alike for
both (correlation 0.93 over 12 views): what the whole set takes Mitsuba is its time for those views,
times what PAVE's renders of the set take over what its renders of those views take.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import pave
from pave.bench.common import (
    Bench,
    Figure,
    Mean,
    WrongAnswer,
    scene_file,
    temporary_folder,
)
from pave.bench.subjects import MITSUBA, Mitsuba
from pave.dataset import CHANNELS, RenderSettings, render_dataset

AOVS = "albedo:albedo,normal:sh_normal,depth:depth"
PAPER_VIEWS = 3080  # of 1000 samples and depth 50
MAX_ALBEDO_ERROR = 0.02  # of the mean over a view: edges fall on other samples


@dataclass(frozen=True)
class Job:
    """A set of views and how each is rendered."""

    case: str
    views: int
    size: int
    spp: int
    rounds: int
    peer_seconds: float  # how long Mitsuba may work in a round; one view in any case
    checked: int = 3  # views whose means both sides must share


def run(bench: Bench) -> None:
    mitsuba = Mitsuba.find(bench)
    rounds = bench.rounds(3)
    if bench.options.quick:
        jobs = [Job("views-100", 6, 16, 64, 1, 0.5), Job("full", 3, 16, 1000, 1, 0.0, 1)]
    else:
        jobs = [Job("views-100", 100, 256, 64, rounds, 20.0), Job("full", 30, 256, 1000, 1, 0.0, 1)]
    for job in jobs:
        measure(bench, mitsuba, job)


def measure(bench: Bench, mitsuba: Mitsuba | None, job: Job) -> None:
    path = scene_file("cornell")
    scene = pave.load_scene(path, defines={"size": job.size})
    views = pave.hemisphere_views(scene, job.views)
    own: list[float] = []
    theirs: list[float] = []
    peer = None if mitsuba is None else Peer(mitsuba, path, job)
    mean, more = None, {}
    with temporary_folder() as name:
        folder = Path(name)
        warm_up(bench, scene, views[:2], job, folder / "warm-up")
        if peer is not None:
            peer.render(views[0], 0, folder / "peer0.exr", spp=4)
        for number in range(job.rounds):
            bench.note(f"{job.case}: PAVE, round {number + 1} of {job.rounds}")
            target = folder / f"round{number}"
            own.append(job.views / own_seconds(bench, scene, views, job, target))
            mean = mean or check(peer, views, target, job.checked)
            if peer is not None:
                bench.note(f"{job.case}: Mitsuba, round {number + 1} of {job.rounds}")
                done, seconds = peer.render_views(views, folder, job.peer_seconds)
                share = cost_share(target, done)
                theirs.append(job.views * share / seconds)
                more = {"peer_views": done, "peer_share": share}
    report(bench, job, own, theirs, mean, more)


def cost_share(folder: Path, count: int) -> float:
    """Of the first `count` views in the time that PAVE rendered all of a set."""
    source = pave.Source(f"exr:{folder}")
    seconds = [source.metadata(number)["seconds_spent"] for number in range(len(source))]
    return sum(seconds[:count]) / sum(seconds)


def report(
    bench: Bench,
    job: Job,
    own: Sequence[float],
    theirs: Sequence[float],
    mean: Mean | None,
    more: dict[str, Any],
) -> None:
    peer = f"{MITSUBA} aov"
    if job.case != "full":
        figure = Figure(job.case, "views_per_second", "views/s", own, peer, theirs or None)
    else:
        mine, other = ([PAPER_VIEWS / rate / 3600 for rate in rates] for rates in (own, theirs))
        figure = Figure(job.case, "hours", "h", mine, peer, other or None, False)
    figure.mean = mean
    figure.more = {"views": job.views, "size": job.size, "spp": job.spp, **more}
    bench.report(figure)


def warm_up(
    bench: Bench, scene: pave.Scene, views: Sequence[pave.View], job: Job, folder: Path
) -> None:
    bench.note(f"{job.case}: warming up")
    own_seconds(bench, scene, views, job, folder)


def own_seconds(
    bench: Bench, scene: pave.Scene, views: Sequence[pave.View], job: Job, folder: Path
) -> float:
    """Seconds of the whole call, from the scene in memory to durable files."""
    settings = RenderSettings(job.size, job.size, job.spp, max_depth=50)
    begin = time.perf_counter()
    counts = render_dataset(bench.device, scene, f"exr:{folder}", views, settings)
    spent = time.perf_counter() - begin
    if counts["acknowledged"] != len(views):
        raise WrongAnswer(f"dataset: {counts['acknowledged']} of {len(views)} views were saved")
    return spent


class Peer:
    """Mitsuba on the same views."""

    def __init__(self, mitsuba: Mitsuba, path: Path, job: Job) -> None:
        self.job, self.mitsuba = job, mitsuba
        self.scene = mitsuba.load(path, job.size, job.spp)
        self.integrator = mitsuba.module.load_dict(
            {"type": "aov", "aovs": AOVS, "image": {"type": "path", "max_depth": 50}}
        )

    def sensor(self, view: pave.View) -> Any:
        size = self.job.size
        film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
        return self.mitsuba.module.load_dict(
            {
                "type": "perspective",
                "fov": view.fov,
                "fov_axis": "x",
                "to_world": self.mitsuba.module.ScalarTransform4f(view.matrix.tolist()),
                "film": film,
                "sampler": {"type": "independent", "sample_count": self.job.spp},
            }
        )

    def render(
        self, view: pave.View, seed: int, output: Path | None = None, spp: int = 0
    ) -> np.ndarray:
        """All planes as (C, H, W), written to `output` if given."""
        sensor = self.sensor(view)
        planes = self.mitsuba.render(
            self.scene, spp or self.job.spp, seed, sensor=sensor, integrator=self.integrator
        )
        if output is not None:
            sensor.film().bitmap().write(str(output))
        return planes

    def render_views(
        self, views: Sequence[pave.View], folder: Path, seconds: float
    ) -> tuple[int, float]:
        """Views written and seconds spent: at least one view, else as many as fit `seconds`."""
        begin = time.perf_counter()
        for done, view in enumerate(views, 1):
            self.render(view, done, folder / f"peer{done}.exr")
            spent = time.perf_counter() - begin
            if spent * (done + 1) / done > seconds:
                break
        return done, spent


def check(peer: Peer | None, views: Sequence[pave.View], folder: Path, shared: int) -> Mean:
    """The mean of what PAVE saved, compared with the peer's. Raises WrongAnswer."""
    source = pave.Source(f"exr:{folder}")
    if len(source) != len(views) or list(source.channels) != list(CHANNELS):
        raise WrongAnswer(f"dataset: {folder.name} has {len(source)} frames of {source.channels}")
    total, variance = np.zeros(3), np.zeros(3)
    for number in range(shared):
        frame = source.read(number)
        color, noise = frame["color"].numpy(), frame["variance"].numpy()
        mean = Mean.of_variance(color, noise)
        if not np.isfinite(color).all():
            raise WrongAnswer(f"dataset: view {number} is not finite")
        total, variance = total + mean.values / shared, variance + (mean.errors / shared) ** 2
        if peer is not None:
            compare(peer.render(views[number], 77 + number), frame, mean, number)
    return Mean(total, np.sqrt(variance))


def compare(planes: np.ndarray, frame: pave.Frame, mean: Mean, number: int) -> None:
    """Mitsuba's color has the same variance as independent samples, a bound of PAVE's own."""
    other = Mean(planes[:3].mean((1, 2), dtype=np.float64), mean.errors)
    mean.check(other, f"dataset: view {number}, PAVE and Mitsuba")
    own = float(frame["albedo"].numpy().mean())
    peer = float(planes[-7:-4].mean())
    if abs(own - peer) > MAX_ALBEDO_ERROR * peer + 1e-3:
        raise WrongAnswer(f"dataset: view {number}: albedo {own:.4f}, Mitsuba's {peer:.4f}")
