"""Evaluation against the metrics themselves, and a report that stands alone.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import base64
import csv
import html.parser
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from training_data import make_sample, make_samples, one_thread  # noqa: F401

from pave import charts, metrics, plots, report
from pave.errors import InputError, UsageError
from pave.evaluate import NOVEL, Evaluation, evaluate
from pave.export import load_generator
from pave.options import TrainOptions
from pave.report import MAX_BYTES, check_report, main, write_report
from pave.run_log import read_history
from pave.train import train

SIZE = 32
SPLITS = {
    "train": make_samples(6, size=SIZE),
    "validation": make_samples(2, first=50, size=SIZE),
    "test": make_samples(4, first=70, size=SIZE),
    NOVEL: make_samples(2, first=90, size=SIZE),
}


@pytest.fixture(scope="module", autouse=True)
def one_thread_for_fixtures() -> None:
    """The fixtures of this module run before one_thread does."""
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    options = TrainOptions(
        filters=4, unet_depth=3, d_filters=4, d_layers=2, epochs=4, batch=2, threads=1
    )
    provenance = {"scene": "<made & up>", "camera": {"fov": 39.3}}
    train(
        (SPLITS["train"], SPLITS["validation"]),
        folder,
        options,
        provenance=provenance,
        figures=False,
    )
    return folder


@pytest.fixture(scope="module")
def evaluation(run: Path) -> Evaluation:
    return evaluate(run, SPLITS)


def test_scores_are_means_of_the_metrics(run: Path, evaluation: Evaluation) -> None:
    generator = load_generator(run)
    ambient = metrics.fit_ambient(SPLITS["train"])
    for split, samples in SPLITS.items():
        means = evaluation.splits[split].means
        for method, draw in (
            ("generated", generator.draw),
            ("direct", lambda sample: sample["direct"]),
            ("ambient", lambda sample: metrics.with_ambient(sample, ambient)),
        ):
            for measure, function in (("psnr", metrics.psnr), ("ssim", metrics.ssim)):
                values = [float(function(draw(s), s["color"])) for s in samples]
                expected = sum(values) / len(values)
                assert means[method][measure] == pytest.approx(expected, rel=1e-6), (split, method)
    scores = evaluation.splits["test"]
    best = max(scores.means["direct"]["psnr"], scores.means["ambient"]["psnr"])
    assert scores.gain == pytest.approx(scores.means["generated"]["psnr"] - best)


def test_evaluation_files(run: Path, evaluation: Evaluation) -> None:
    record = json.loads((run / "evaluation.json").read_text())
    assert record == evaluation.to_json()
    assert record["splits"]["test"]["generated"]["psnr"] > 0
    with open(run / "evaluation.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(len(samples) for samples in SPLITS.values())
    assert {row["split"] for row in rows} == set(SPLITS)
    assert f"{evaluation.splits['test'].means['generated']['psnr']:.2f}" in evaluation.table()


def test_evaluation_without_what_it_needs(run: Path) -> None:
    with pytest.raises(UsageError, match="'train'"):
        evaluate(run, {"test": SPLITS["test"]})
    with pytest.raises(UsageError, match="novel split has no images"):
        evaluate(run, {"train": SPLITS["train"], NOVEL: []}, write=False)
    bare = [{k: v for k, v in sample.items() if k != "color"} for sample in SPLITS["test"]]
    with pytest.raises(UsageError, match="no channel 'color'"):
        evaluate(run, {"train": SPLITS["train"], "test": bare}, write=False)


def test_evaluation_without_baselines(run: Path, tmp_path: Path) -> None:
    """A network of other inputs, on frames without what a baseline is made from: its own scores alone."""
    bare = {
        name: [{k: s[k] for k in ("color", "position", "normal")} for s in samples]
        for name, samples in SPLITS.items()
    }
    options = TrainOptions.from_json(
        {"inputs": ["position", "normal"], "head": "sigmoid", "filters": 4, "unet_depth": 3}
        | {"d_filters": 4, "d_layers": 2, "epochs": 1, "threads": 1}
    )
    train((bare["train"], bare["validation"]), tmp_path, options, figures=False)
    result = evaluate(tmp_path, bare)
    test = result.splits["test"]
    assert list(test.means) == ["generated"]
    assert (test.gain, test.baseline_psnr, result.ambient) == (None, None, None)
    record = json.loads((tmp_path / "evaluation.json").read_text())
    assert "ambient" not in record
    assert set(record["splits"]["test"]) == {"images", "generated"}
    assert "ambient" not in (tmp_path / "evaluation.csv").read_text()
    page = write_report(tmp_path / "report.html", tmp_path, {"test": bare["test"]}, result)
    assert "over the better baseline</span>" not in page.read_text()
    # Direct light without albedo is a baseline of its own, and not every split has to have it.
    with_direct = {**SPLITS, "train": bare["train"]}
    result = evaluate(tmp_path, with_direct, write=False)
    assert list(result.splits["test"].means) == ["generated", "direct"]
    assert result.splits["train"].gain is None


def test_evaluation_tells_its_progress(run: Path) -> None:
    told: list[tuple[int, int]] = []
    evaluate(run, SPLITS, write=False, on_progress=lambda *record: told.append(record))
    total = sum(map(len, SPLITS.values())) + len(SPLITS["train"])  # once more for the ambient
    assert told == [(done, total) for done in range(1, total + 1)]


def test_evaluation_of_images_too_small_to_be_compared(run: Path) -> None:
    small = [make_sample(index, 16, 10) for index in range(2)]
    with pytest.raises(UsageError, match="16x10 pixels are too small"):
        evaluate(run, {"train": SPLITS["train"], NOVEL: small}, write=False)


class Page(html.parser.HTMLParser):
    """Text and tags of a page; complains about tags that are not closed in order."""

    VOID = ("meta", "img", "input", "br", "line", "rect", "circle", "polyline")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.images: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attributes: list) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "img":
            self.images.append(dict(attributes)["src"])

    def handle_startendtag(self, tag: str, attributes: list) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


@pytest.fixture(scope="module")
def page(run: Path, evaluation: Evaluation) -> str:
    path = write_report(
        run / "report.html",
        run,
        {"test": SPLITS["test"], NOVEL: SPLITS[NOVEL]},
        evaluation,
        stages={"render": 61.5, "train": 12.0},
        provenance={"device": "pocl", "seed": 7},
    )
    return path.read_text()


def test_report_has_everything(page: str, evaluation: Evaluation) -> None:
    words = " ".join(Page(page).words)
    for title in (
        "One view, two ways",
        "Views it never saw",
        "A scene it never saw",
        "How close it comes",
        "How it learned",
        "Where the time went",
        "Provenance",
    ):
        assert title in words
    for scores in evaluation.splits.values():
        for values in scores.means.values():
            assert f"{values['psnr']:.2f}" in words
            assert f"{values['ssim']:.4f}" in words
    assert "1 min 14 s" in words, "the stages' sum"
    assert "<made & up>" in words, "provenance is shown, and as text"
    assert "camera.fov" in words
    assert evaluation.weights_version in words
    assert page.count('<svg class="chart"') == 4


def test_report_shows_the_verdict_on_the_weights_that_it_shows(
    run: Path, evaluation: Evaluation, page: str
) -> None:
    best = load_generator(run).training["best"]
    verdict = f"<b>{best['val_d_real']:.2f} / {best['val_d_fake']:.2f}</b>"
    assert verdict in page
    history = [{**row, "val_d_real": 0.123, "val_d_fake": 0.321} for row in read_history(run)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "read_history", lambda _: history)
        told: list[tuple[int, int]] = []
        path = write_report(
            run / "other.html",
            run,
            {"test": SPLITS["test"]},
            evaluation,
            on_progress=lambda *record: told.append(record),
        )
    assert verdict in path.read_text()
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_report_images_are_whole_and_right(page: str, run: Path) -> None:
    import io

    import numpy as np
    from PIL import Image

    images = Page(page).images
    # Slider 2, buffers 4, and for each shown image 4 pictures and 4 crops: 3 of the test split, 2 of the novel scene.
    assert len(images) == 2 + 4 + 8 * (3 + 2)
    pictures = []
    for source in images:
        head, data = source.split(",", 1)
        assert head == "data:image/png;base64"
        pictures.append(np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))))
    shown = [plots.display_pixels(s["color"]) for s in SPLITS["test"]]
    factor = pictures[0].shape[0] // SIZE
    assert any((pictures[0][::factor, ::factor] == pixels).all() for pixels in shown)


def test_report_stands_alone(page: str, tmp_path: Path) -> None:
    good, bad = tmp_path / "good.html", tmp_path / "bad.html"
    good.write_text(page)
    assert check_report(good) == []
    for harm in (
        "<img src='picture.png'>",
        '<a href="other.html">',
        "<script src=x.js></script>",
        "<style>p{background:url(a.png)}</style>",
        "<p>see https" + "://example.org</p>",
    ):
        bad.write_text(page.replace("</main>", harm + "</main>"))
        assert check_report(bad), harm
    bad.write_text(page + " " * MAX_BYTES)
    assert "bytes" in check_report(bad)[0]
    assert main(["--check", str(good)]) == 0
    assert main(["--check", str(tmp_path / "none.html")]) == 3
    command = [sys.executable, "-m", "pave.report", "--check", str(bad)]
    done = subprocess.run(
        command, capture_output=True, text=True, env=_python_path(), timeout=120, check=False
    )
    assert done.returncode == 3, done.stderr
    assert done.stderr.count("\n") == 1


def _python_path() -> dict[str, str]:
    import os

    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


def test_damaged_run_gives_no_report(run: Path, evaluation: Evaluation, tmp_path: Path) -> None:
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    weights = bytearray((copy / "generator.safetensors").read_bytes())
    weights[-5] ^= 4
    (copy / "generator.safetensors").write_bytes(weights)
    with pytest.raises(InputError, match=r"generator\.safetensors"):
        write_report(tmp_path / "report.html", copy, {"test": SPLITS["test"]}, evaluation)
    assert not (tmp_path / "report.html").exists()


def test_ticks_are_round_and_inside() -> None:
    for low, high in ((0.0, 1.0), (21.3, 37.9), (1.0, 40.0), (0.0, 0.0031), (-5.0, 5.0)):
        ticks = charts.nice_ticks(low, high)
        assert 3 <= len(ticks) <= 12
        assert all(low - 1e-9 <= tick <= high + 1e-9 for tick in ticks)
        assert all(len(f"{tick:.10g}") <= 7 for tick in ticks), ticks
    assert charts.nice_ticks(2.0, 2.0) == [2.0]
    assert charts.log_ticks(0.008, 0.3) == pytest.approx([0.01, 0.02, 0.05, 0.1, 0.2])


def test_chart_puts_points_where_they_belong() -> None:
    line = charts.Line("x", [(0, 0.0), (5, 0.5), (10, 1.0)], 1)
    svg = charts.line_chart("t", [line], y_range=(0.0, 1.0), reference=0.5)
    points = re.search(r'points="([^"]+)"', svg)
    assert points
    (x0, y0), (x1, y1), (x2, y2) = (map(float, p.split(",")) for p in points.group(1).split())
    assert (x0, x2) == (charts.LEFT, charts.WIDTH - charts.RIGHT)
    assert (y0, y2) == (charts.HEIGHT - charts.BOTTOM, charts.TOP)
    assert x1 == pytest.approx((x0 + x2) / 2, abs=0.1)
    assert y1 == pytest.approx((y0 + y2) / 2, abs=0.1)
    assert f'y1="{y1:.1f}"' in svg, "the reference level goes through the middle"
    assert charts.line_chart("t", [charts.Line("x", [(1, float("nan"))], 1)]) == ""
    assert charts.line_chart("t", [charts.Line("x", [(1, 0.0)], 1)], log=True) == ""


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.04, "0.0 s"), (9.96, "10.0 s"), (59.4, "59 s"), (425, "7 min 05 s"), (11400, "3 h 10 min")],
)
def test_durations(seconds: float, text: str) -> None:
    assert charts.duration_text(seconds) == text


def test_channels_as_pictures() -> None:
    sample = SPLITS["test"][0]
    miss = torch.isinf(sample["depth"][0]).numpy()
    for channel, planes in sample.items():
        pixels = plots.channel_pixels(channel, planes)
        assert pixels.shape == (SIZE, SIZE, 3)
        if channel in ("depth", "normal"):
            assert (pixels[miss] == 0).all(), "a miss is black"
            assert (pixels[~miss].max(-1) > 0).all()
    same = plots.difference_pixels(sample["color"], sample["color"], 8.0)
    assert (same == same[0, 0]).all()
