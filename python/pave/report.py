"""One offline HTML page about a run: images, scores, curves, where the time went, and provenance.

SPDX-License-Identifier: BSD-3-Clause

    python -m pave.report --check report.html     # nothing outside the file is needed, below 20 MB
"""

from __future__ import annotations

import base64
import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pave import charts, metrics, plots
from pave.charts import Line, Span
from pave.errors import InputError
from pave.evaluate import NOVEL, Evaluation, draw_all
from pave.export import ExportedGenerator, load_generator
from pave.files import read_bytes, write_atomic
from pave.run_log import Row, read_history
from pave.schema import TARGET, Sample

MAX_BYTES = 20_000_000
DIFFERENCE_GAIN = 8.0
MIN_PIXELS = 384  # small images are enlarged by whole numbers, so that no viewer blurs them

METHOD_NAMES = {"generated": "generated", "direct": "direct light", "ambient": "direct + ambient"}
SPLIT_NAMES = {
    "train": "training",
    "validation": "validation",
    "test": "test",
    NOVEL: "novel scene",
}


def write_report(
    path: str | Path,
    run: str | Path,
    samples: Mapping[str, Sequence[Sample]],
    evaluation: Evaluation,
    *,
    title: str = "PAVE: drawing global illumination from cheap buffers",
    subtitle: str = "",
    stages: Mapping[str, float] | None = None,
    spans: Sequence[Span] = (),
    provenance: Mapping[str, Any] | None = None,
    on_progress: Callable[[int, int], Any] | None = None,
) -> Path:
    """Writes the report of `run` to `path` and returns it.

    `samples` are the splits to show, "test" and perhaps "novel". `stages` are seconds by stage, one after the other; `spans`
    say more exactly what overlapped and win. `provenance` is any JSON, shown beside the run's own. `on_progress(done, total)`
    is called after each frame that is shown. Raises InputError for a damaged run, RunError if the page cannot be written.
    """
    run, path = Path(run), Path(path)
    generator = load_generator(run)
    history = read_history(run)
    page = {
        "title": title,
        "subtitle": subtitle or _subtitle(generator),
        "tiles": _tiles(evaluation, generator.training.get("best", {}), stages, spans),
        "scores": _score_rows(evaluation),
        "charts": _charts(history),
        "provenance": _provenance(generator, evaluation, provenance or {}),
        **_time(stages, spans),
        **_pictures(generator, samples, evaluation, on_progress),
    }
    write_atomic(path, _template().render(page).encode())
    return path


def write_overview(
    path: Path,
    run: str | Path,
    samples: Mapping[str, Sequence[Sample]],
    evaluation: Evaluation,
) -> Path:
    """One picture of what a run does, as PNG: buffers, drawn and path traced image of the view of each split in which the
    most pixels are lit; other views of a box show much of its outside."""
    generator = load_generator(Path(run))
    rows = []
    for split, dataset in samples.items():
        sample = dataset[max(range(len(dataset)), key=lambda index: _lit(dataset[index]))]
        drawn = draw_all(generator, sample, evaluation.ambient)["generated"]
        pictures = [
            (name, plots.channel_pixels(name, sample[name])) for name in generator.schema.channels
        ]
        pictures.append(
            (
                f"drawn by the network\n{float(metrics.psnr(drawn, sample[TARGET])):.1f} dB",
                plots.display_pixels(drawn),
            )
        )
        pictures.append(("path traced", plots.display_pixels(sample[TARGET])))
        rows.append((SPLIT_NAMES.get(split, split) + " view", pictures))
    write_atomic(path, plots.to_png(plots.overview_figure(rows)))
    return path


def _lit(sample: Sample) -> float:
    """Share of pixels that are not black."""
    return float((sample[TARGET].amax(0) > 1e-3).float().mean())


def check_report(path: str | Path) -> list[str]:
    """What is wrong with a report: references to other files, or size. Empty if it stands alone."""
    data = read_bytes(Path(path))
    text = data.decode("utf-8", "replace")
    problems = []
    if len(data) >= MAX_BYTES:
        problems.append(f"{len(data)} bytes, {MAX_BYTES} are allowed")
    found = re.search(r"https?://\S{0,60}", text)
    if found:
        problems.append(f"refers to {found.group(0)}")
    for match in re.finditer(
        r"\b(?:src|href)\s*=\s*[\"']?([^\"'\s>]{0,60})|url\(([^)]{0,60})", text
    ):
        target = match.group(1) or match.group(2) or ""
        if not target.startswith(("data:", "#")):
            problems.append(f"refers to {target}")
    return problems


def _template() -> Any:
    import jinja2

    folder = Path(__file__).parent / "templates"
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        trim_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template("report.html.j2")


# Pictures ------------------------------------------------------------------------------------------------------------


def _embed(pixels: np.ndarray) -> str:
    factor = max(1, -(-MIN_PIXELS // max(pixels.shape[:2])))
    if factor > 1:
        pixels = pixels.repeat(factor, 0).repeat(factor, 1)
    return "data:image/png;base64," + base64.b64encode(plots.image_png(pixels)).decode()


def _pictures(
    generator: ExportedGenerator,
    samples: Mapping[str, Sequence[Sample]],
    evaluation: Evaluation,
    on_progress: Callable[[int, int], Any] | None,
) -> dict[str, Any]:
    groups: list[dict[str, Any]] = []
    slider, buffers = None, []
    examples = {
        split: _examples(evaluation.splits[split].per_image)
        for split, dataset in samples.items()
        if split in evaluation.splits and len(dataset) > 0
    }
    done, total = 0, sum(len(chosen) for chosen in examples.values())
    for split, chosen in examples.items():
        rows = []
        for index, kind in chosen:
            sample = samples[split][index]
            images = draw_all(generator, sample, evaluation.ambient)
            if slider is None:
                slider = {
                    "truth": _embed(plots.display_pixels(sample[TARGET])),
                    "generated": _embed(plots.display_pixels(images["generated"])),
                    "caption": f"Image {index} of the {SPLIT_NAMES.get(split, split)} split.",
                }
                buffers = [
                    {"name": name, "image": _embed(plots.channel_pixels(name, sample[name]))}
                    for name in generator.schema.channels
                ]
            rows.append(_comparison(sample, images, f"{kind}, image {index}"))
            done += 1
            if on_progress is not None:
                on_progress(done, total)
        groups.append(_group(split, rows))
    return {"groups": groups, "slider": slider, "buffers": buffers}


def _group(split: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    text = (
        "Median, best and worst image of the split by PSNR. The difference is enlarged "
        f"{DIFFERENCE_GAIN:g} times; below each picture the square marked in it, enlarged."
    )
    if split == NOVEL:
        title = "A scene it never saw"
        text = "The same network on another scene: other objects, other places. " + text
    else:
        title = f"Views of the {SPLIT_NAMES.get(split, split)} split"
        if split == "test":
            title = "Views it never saw"
    return {"title": title, "text": text, "rows": rows}


def _examples(rows: Sequence[Row]) -> list[tuple[int, str]]:
    """(image, what it stands for): nothing is picked by hand."""
    ranked = sorted(rows, key=lambda row: row["generated_psnr"])
    chosen = [(ranked[len(ranked) // 2], "median"), (ranked[-1], "best"), (ranked[0], "worst")]
    unique: dict[int, str] = {}
    for row, kind in chosen:
        unique.setdefault(int(row["image"]), kind)
    return list(unique.items())


def _comparison(sample: Sample, images: Mapping[str, torch.Tensor], label: str) -> dict[str, Any]:
    """Truth, generated, direct and difference of one frame, with a crop where direct light errs most."""
    truth, generated = sample[TARGET], images["generated"]
    pictures = [("path traced", label, plots.display_pixels(truth))]
    pictures.append(("generated", _note(generated, truth), plots.display_pixels(generated)))
    if "direct" in images:
        direct = images["direct"]
        pictures.append(("direct light", _note(direct, truth), plots.display_pixels(direct)))
    difference = plots.difference_pixels(generated, truth, DIFFERENCE_GAIN)
    note = f"of path traced and generated, x {DIFFERENCE_GAIN:g}"
    pictures.append(("difference", note, difference))
    box = _busiest_box(truth)
    top, left, side = box
    height, width = difference.shape[:2]
    cells = [
        {
            "name": name,
            "note": note,
            "image": _embed(pixels),
            "crop": _embed(pixels[top : top + side, left : left + side]),
        }
        for name, note, pixels in pictures
    ]
    percent = [100 * left / width, 100 * top / height, 100 * side / width, 100 * side / height]
    return {"cells": cells, "box": [f"{value:.3f}" for value in percent]}


def _note(image: torch.Tensor, truth: torch.Tensor) -> str:
    score = f"{float(metrics.psnr(image, truth)):.2f} dB"
    if min(truth.shape[-2:]) > 2 * metrics.SSIM_RADIUS:
        score += f", SSIM {float(metrics.ssim(image, truth)):.4f}"
    return score


def _busiest_box(truth: torch.Tensor) -> tuple[int, int, int]:
    """(top, left, side) of the quarter-size square with the most contrast inside the scene: neither lamps nor nothing."""
    lamp = (truth >= 1).all(0).numpy()
    nothing = (truth <= 0).all(0).numpy()
    grey = plots.display_pixels(truth).astype(np.float64).mean(-1)
    side = max(8, min(grey.shape) // 4)
    best, place = -1.0, (0, 0)
    for top in range(0, grey.shape[0] - side + 1, max(side // 4, 1)):
        for left in range(0, grey.shape[1] - side + 1, max(side // 4, 1)):
            window = np.s_[top : top + side, left : left + side]
            outside = lamp[window].any() or nothing[window].mean() > 0.05
            spread = -0.5 if outside else float(grey[window].std())
            if spread > best:
                best, place = spread, (top, left)
    return place[0], place[1], side


# Numbers -------------------------------------------------------------------------------------------------------------


def _subtitle(generator: ExportedGenerator) -> str:
    images = generator.training.get("images", {})
    size = generator.training.get("size", ["?", "?"])
    return (
        f"A conditional GAN, trained on {images.get('training', '?')} views of {size[0]}x{size[1]} pixels, draws the "
        f"path-traced image from {', '.join(generator.schema.channels)}."
    )


def _tiles(
    evaluation: Evaluation,
    best: Mapping[str, float],
    stages: Mapping[str, float] | None,
    spans: Sequence[Span],
) -> list[dict[str, str]]:
    tiles = []
    scores = evaluation.splits.get("test") or next(iter(evaluation.splits.values()))
    ours = scores.means["generated"]
    name = SPLIT_NAMES.get(scores.name, scores.name)
    tiles.append({"value": f"{ours['psnr']:.1f} dB", "label": f"PSNR on the {name} split"})
    tiles.append({"value": f"{ours['ssim']:.3f}", "label": f"SSIM on the {name} split"})
    if scores.gain is not None:
        tiles.append({"value": f"{scores.gain:+.1f} dB", "label": "over the better baseline"})
    if NOVEL in evaluation.splits:
        novel = evaluation.splits[NOVEL].means["generated"]["psnr"]
        tiles.append({"value": f"{novel:.1f} dB", "label": "PSNR on the novel scene"})
    if "val_d_real" in best:  # of the epoch whose weights these are
        verdict = f"{best['val_d_real']:.2f} / {best['val_d_fake']:.2f}"
        tiles.append({"value": verdict, "label": "verdict on traced / generated"})
    total = max((span.end for span in spans), default=sum((stages or {}).values()))
    if total > 0:
        tiles.append({"value": charts.duration_text(total), "label": "from scene to report"})
    return tiles


def _score_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    rows = []
    for split, scores in evaluation.splits.items():
        for position, (method, values) in enumerate(scores.means.items()):
            ours = method == "generated"
            name = f"{SPLIT_NAMES.get(split, split)} ({scores.images})"
            rows.append(
                {
                    "split": name if position == 0 else "",
                    "method": METHOD_NAMES[method],
                    "ours": ours,
                    "psnr": f"{values['psnr']:.2f}",
                    "ssim": f"{values['ssim']:.4f}",
                    "l1": f"{values['l1']:.4f}",
                    "rel_mse": f"{values['rel_mse']:.4f}",
                    "gain": f"{scores.gain:+.2f} dB" if ours and scores.gain is not None else "",
                }
            )
    return rows


def _charts(history: Sequence[Row]) -> list[dict[str, str]]:
    def line(column: str, label: str, tone: int, dashed: bool = False) -> Line:
        points = [(row["epoch"], row[column]) for row in history if column in row]
        return Line(label, points, tone, dashed)

    losses = [
        line("g_l1", "generator, L1", 1),
        line("val_l1", "generator, L1 on validation", 1, True),
        line("g_adversarial", "generator, adversarial", 3),
        line("d_loss", "discriminator", 2),
    ]
    verdicts = [line("val_d_real", "path traced", 2), line("val_d_fake", "generated", 1)]
    drawn = (
        ("Losses", losses, {"log": True}),
        ("Mean verdict of the discriminator", verdicts, {"y_range": (0.0, 1.0), "reference": 0.5}),
        ("PSNR on the validation split, dB", [line("val_psnr", "generated", 1)], {}),
        ("SSIM on the validation split", [line("val_ssim", "generated", 1)], {}),
    )
    result = []
    for title, lines, style in drawn:
        svg = charts.line_chart(title, lines, **style)
        if svg:
            result.append({"title": title, "svg": svg, "legend": charts.legend(lines)})
    return result


def _time(stages: Mapping[str, float] | None, spans: Sequence[Span]) -> dict[str, str]:
    spans = list(spans) or charts.spans_of_stages(dict(stages or {}))
    total = max((span.end for span in spans), default=0.0)
    text = f"{charts.duration_text(total)} of wall time from start to end." if total else ""
    return {"time_line": charts.time_line(spans), "time_text": text}


def _provenance(
    generator: ExportedGenerator, evaluation: Evaluation, extra: Mapping[str, Any]
) -> list[dict[str, Any]]:
    training = dict(generator.training)
    training.pop("schema", None)
    network = {
        "weights (XXH3-128)": evaluation.weights_version,
        "parameters": sum(tensor.numel() for tensor in generator.weights.values()),
        "layers": len(generator.nodes),
        "sizes": f"any; padded to multiples of {generator.multiple}",
        **generator.schema.to_json(),
    }
    blocks = [("Data and renderer", extra), ("Network", network), ("Training", training)]
    return [{"title": title, "rows": list(_flat("", record))} for title, record in blocks if record]


def _flat(prefix: str, value: Any) -> Any:
    """Nested JSON as (key, text) rows."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _flat(f"{prefix}.{key}" if prefix else str(key), item)
    elif isinstance(value, float):
        yield prefix, f"{value:.9g}"
    elif isinstance(value, (list, tuple)):
        if any(isinstance(item, Mapping) for item in value):
            for index, item in enumerate(value):
                yield from _flat(f"{prefix}[{index}]", item)
        else:
            yield prefix, json.dumps(list(value))
    else:
        yield prefix, str(value)


def main(arguments: Sequence[str]) -> int:
    """`python -m pave.report --check FILE`: 0 if the report stands alone, 3 if not."""
    if len(arguments) != 2 or arguments[0] != "--check":
        print("usage: python -m pave.report --check report.html", file=sys.stderr)
        return 2
    try:
        problems = check_report(arguments[1])
    except InputError as error:
        problems = [str(error)]
    for problem in problems:
        print(f"{arguments[1]}: {problem}", file=sys.stderr)
    return 3 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
