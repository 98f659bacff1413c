"""The papers' experiment from end to end: render, share, train, evaluate, draw with what was learned, report.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pave.checks import UINT64_MAX, whole
from pave.console import Console
from pave.dataset import CHANNELS, RenderSettings, render_dataset
from pave.errors import InputError, UsageError
from pave.files import make_folder, read_bytes, remove_stale, write_json

if TYPE_CHECKING:
    import pave
    from pave.data import Dataset
    from pave.evaluate import Evaluation

SCENE, NOVEL_SCENE = "cornell", "novel"
SECONDS_FILE = "seconds.json"
DRAWN_VIEWS = 8


@dataclass(frozen=True)
class DemoSetting:
    """One size of the experiment. `training` are options of pave.options.TrainOptions."""

    views: int
    novel_views: int
    size: int
    spp: int
    max_depth: int
    training: dict[str, Any] = field(default_factory=dict)


SETTINGS = {
    "quick": DemoSetting(60, 10, 64, 64, 50, {"epochs": 30, "filters": 16, "unet_depth": 4}),
    "standard": DemoSetting(480, 48, 128, 256, 50, {"minutes": 8.0}),
    # The papers: 3080 views, 256x256, 1000 samples, depth 50, 400 epochs.
    "full": DemoSetting(
        3080,
        96,
        256,
        1000,
        50,
        {
            "epochs": 400,
            "filters": 64,
            "unet_depth": 6,
            "batch": 4,
            "lr": 5e-4,
            "repeat_depth": 3,  # 12 planes of buffers and 3 of the image
        },
    ),
}


def _read_json(path: Path) -> Any:
    try:
        return json.loads(read_bytes(path))
    except ValueError as error:
        raise InputError(f"{path}: is damaged: {error}; name another folder") from error


class _Demo:
    """One folder of the experiment; each step goes on where an earlier call was stopped."""

    def __init__(self, console: Console, folder: Path, name: str, device: str, seed: int) -> None:
        import pave

        self.console, self.folder, self.setting, self.seed = console, folder, SETTINGS[name], seed
        # All that may be refused comes before anything is written.
        whole("seed", seed, 0, UINT64_MAX)
        self.device = pave.Device(device)
        self._agree_on_setting(name)
        self.trace = pave.Trace()
        self.run = folder / "run"
        self.data, self.novel = f"bp:{folder / 'cornell.bp'}", f"bp:{folder / 'novel.bp'}"
        self.seconds, self.done = self._earlier_seconds()

    def _agree_on_setting(self, name: str) -> None:
        """Makes the folder, or looks whether the demo in it is this one."""
        path = self.folder / "demo.json"
        record = {"setting": name, "seed": self.seed, **asdict(self.setting)}
        remove_stale(self.folder)
        if path.exists():
            there = _read_json(path)
            if not isinstance(there, dict) or "setting" not in there:
                raise InputError(f"{path}: is not a demo's setting; name another folder")
            if there != record:
                raise UsageError(
                    f"{self.folder} holds a demo of another setting; name another folder"
                )
            return
        if self.folder.is_dir() and any(self.folder.iterdir()):
            raise UsageError(f"{self.folder} is not empty and holds no demo; name another folder")
        make_folder(self.folder)
        write_json(path, record)

    # Time ------------------------------------------------------------------------------------------------------------

    def _earlier_seconds(self) -> tuple[dict[str, float], set[str]]:
        """Seconds by step that earlier calls took, and which steps they finished."""
        path = self.folder / SECONDS_FILE
        if not path.exists():
            return {}, set()
        record = _read_json(path)
        try:
            seconds = {str(name): float(value) for name, value in record["seconds"].items()}
            return seconds, {str(name) for name in record["done"]}
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: not a demo's times: {error}; delete it") from error

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Adds the wall time of its body, interrupted or not, to that of earlier calls; a step done before keeps its own."""
        begin = time.perf_counter()
        finished = False
        try:
            with self.trace.span(name):
                yield
            finished = True
        finally:
            if name not in self.done:
                self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin
                if finished:
                    self.done.add(name)
                record = {"seconds": self.seconds, "done": sorted(self.done)}
                write_json(self.folder / SECONDS_FILE, record)
        self.console.event({"stage": name, "seconds": self.seconds[name]})

    # Steps -----------------------------------------------------------------------------------------------------------

    @property
    def settings(self) -> RenderSettings:
        size = self.setting.size
        return RenderSettings(
            size, size, self.setting.spp, self.setting.max_depth, seed=self.seed, channels=CHANNELS
        )

    def render(self, scene_name: str, uri: str, count: int, seed: int) -> None:
        """The data set of one scene, all its buffers in one pass."""
        import pave

        scene = pave.load_scene(scene_name)
        views = pave.hemisphere_views(scene, count, seed)
        with self.console.progress(f"render {scene_name}", count, "frames") as bar:

            def on_frame(done: int, stage: pave.Stage) -> None:
                bar.update(done)
                self.console.event(
                    {"stage": "render", "scene": scene_name, "frames": done, "of": count}
                )

            render_dataset(
                self.device,
                scene,
                uri,
                views,
                self.settings,
                resume=Path(uri.partition(":")[2]).exists(),
                trace=self.trace,
                on_frame=on_frame,
            )

    def train(self) -> dict[str, Any]:
        from pave.training_session import run_training

        options = {**self.setting.training, "seed": self.seed}
        provenance = {"scene": SCENE, "spp": self.setting.spp, "max_depth": self.setting.max_depth}
        return run_training(self.console, self.data, self.run, options, provenance)

    def splits(self) -> dict[str, Dataset]:
        import pave

        loader = pave.DataLoader(self.data)
        loader.open(list(CHANNELS))
        train, test, validation = loader.get_split()
        novel = pave.Dataset(self.novel, list(CHANNELS))
        return {"train": train, "validation": validation, "test": test, "novel": novel}

    def draw(self, test: Dataset, on_view: Callable[[int, int], None]) -> dict[str, Any]:
        """Draws views of the test split in the renderer; see DrawnViews.draw."""
        import pave
        from pave.drawing import DrawnViews

        figures = self.folder / "figures"
        figures.mkdir(exist_ok=True)
        views = DrawnViews(self.device, pave.load_scene(SCENE), self.run, test, figures)
        return views.draw(DRAWN_VIEWS, on_view)

    def report(
        self,
        splits: dict[str, Dataset],
        scores: Evaluation,
        drawn: dict[str, Any],
        on_picture: Callable[[int, int], None],
    ) -> Path:
        from pave.report import write_overview, write_report

        provenance = {
            "demo": asdict(self.setting),
            "device": self.device.profile.to_dict(),
            "drawn in the renderer": drawn,
            "data": dict(splits["train"].metadata(0)),
            "novel scene": {
                "views": len(splits["novel"]),
                **splits["novel"].metadata(0),
            },
        }
        shown = {"test": splits["test"], "novel": splits["novel"]}
        write_overview(self.folder / "figures" / "overview.png", self.run, shown, scores)
        return write_report(
            self.folder / "report.html",
            self.run,
            shown,
            scores,
            stages=self.seconds,
            provenance=provenance,
            on_progress=on_picture,
        )


def run_demo(
    console: Console, folder: Path, name: str, *, device: str = "", seed: int = 0
) -> dict[str, Any]:
    """The whole experiment into `folder`; `name` is "quick", "standard" or "full". Returns its figures.

    A second call goes on where the first was stopped. Raises UsageError if the folder holds something else, InputError if
    what it holds is damaged, RunError if it was interrupted in its training.
    """
    demo = _Demo(console, folder, name, device, seed)
    try:
        return _run_steps(demo)
    finally:
        demo.trace.write(folder / "trace.json")


def _run_steps(demo: _Demo) -> dict[str, Any]:
    from pave.training_session import evaluate_splits

    console, setting, seed = demo.console, demo.setting, demo.seed
    with demo.step("render"):
        demo.render(SCENE, demo.data, setting.views, seed)
    with demo.step("render novel scene"):
        demo.render(NOVEL_SCENE, demo.novel, setting.novel_views, (seed + 1) % (UINT64_MAX + 1))
    with demo.step("train"):
        training = demo.train()
    splits = demo.splits()
    with demo.step("evaluate"):
        scores = evaluate_splits(console, demo.run, splits)
    with demo.step("draw"), console.counted("draw", "views") as step:
        drawn = demo.draw(splits["test"], step)
    with demo.step("report"), console.counted("report", "pictures") as step:
        page = demo.report(splits, scores, drawn, step)
    if not console.json_lines:
        console.say(scores.table())
    test = scores.splits["test"]
    return {
        "folder": str(demo.folder),
        "report": str(page),
        "psnr": test.means["generated"]["psnr"],
        "ssim": test.means["generated"]["ssim"],
        "baseline_psnr": test.baseline_psnr,
        "novel_psnr": scores.splits["novel"].means["generated"]["psnr"],
        "d_real": training["d_real"],
        "d_fake": training["d_fake"],
        "seconds": demo.seconds,
        "drawn": drawn,
    }
