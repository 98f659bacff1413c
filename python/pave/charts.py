"""Charts as inline SVG for the report: no script, no fonts of their own, colours from the page's light or dark theme.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

Point = tuple[float, float]

WIDTH, HEIGHT = 460, 260
LEFT, RIGHT, TOP, BOTTOM = 52, 16, 12, 34


@dataclass(frozen=True)
class Line:
    """One curve. `tone` 1..4 picks a colour of the page's palette."""

    label: str
    points: Sequence[Point]
    tone: int
    dashed: bool = False


def nice_ticks(low: float, high: float, count: int = 5) -> list[float]:
    """About `count` round numbers from `low` to `high` (Heckbert 1990)."""
    span = high - low
    if not span > 0:
        return [low]
    raw = span / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [round(step * i, 12) for i in range(first, last + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 of every power of ten within, or powers alone when there are many."""
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    digits = (1, 2, 5) if len(exponents) <= 4 else (1,)
    ticks = [digit * 10.0**exponent for exponent in exponents for digit in digits]
    return [tick for tick in ticks if low * 0.999 <= tick <= high * 1.001]


def tick_label(value: float) -> str:
    return f"{value:.6g}"


class _Axis:
    """Maps values to pixels."""

    def __init__(self, low: float, high: float, start: float, end: float, log: bool = False):
        self.log = log
        self.low, self.high = (math.log10(low), math.log10(high)) if log else (low, high)
        self.start, self.end = start, end

    def __call__(self, value: float) -> float:
        value = math.log10(value) if self.log else value
        share = (value - self.low) / ((self.high - self.low) or 1.0)
        return self.start + share * (self.end - self.start)


def line_chart(
    title: str,
    lines: Sequence[Line],
    *,
    log: bool = False,
    y_range: tuple[float, float] | None = None,
    reference: float | None = None,
) -> str:
    """Curves over epochs as an <svg> element; "" if there is nothing to draw. `reference` is a dotted level."""
    lines = [
        Line(line.label, [p for p in line.points if _drawable(p[1], log)], line.tone, line.dashed)
        for line in lines
    ]
    lines = [line for line in lines if line.points]
    if not lines:
        return ""
    xs = [x for line in lines for x, _ in line.points]
    ys = [y for line in lines for _, y in line.points]
    low, high = y_range or _padded(min(ys), max(ys), log)
    x_axis = _Axis(min(xs), max(xs), LEFT, WIDTH - RIGHT)
    y_axis = _Axis(low, high, HEIGHT - BOTTOM, TOP, log)
    parts = [
        f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">'
    ]
    for tick in log_ticks(low, high) if log else nice_ticks(low, high):
        y = y_axis(tick)
        parts.append(
            f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
        )
        parts.append(
            f'<text class="tick" x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{tick_label(tick)}</text>'
        )
    for tick in nice_ticks(min(xs), max(xs), 6):
        if tick == int(tick):
            parts.append(
                f'<text class="tick" x="{x_axis(tick):.1f}" y="{HEIGHT - 16}" text-anchor="middle">{tick_label(tick)}</text>'
            )
    parts.append(
        f'<text class="tick" x="{WIDTH - RIGHT}" y="{HEIGHT - 2}" text-anchor="end">epoch</text>'
    )
    if reference is not None:
        y = y_axis(reference)
        parts.append(
            f'<line class="reference" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
        )
    for line in lines:
        parts.append(_curve(line, x_axis, y_axis))
    parts.append("</svg>")
    return "".join(parts)


def legend(lines: Sequence[Line]) -> str:
    """The key of a chart, with each curve's last value."""
    items = []
    for line in lines:
        if line.points:
            dash = " dashed" if line.dashed else ""
            value = f"{line.points[-1][1]:.4g}"
            items.append(
                f'<li><i class="key tone{line.tone}{dash}"></i>{escape(line.label)} <b>{value}</b></li>'
            )
    return f'<ul class="legend">{"".join(items)}</ul>'


def _curve(line: Line, x_axis: _Axis, y_axis: _Axis) -> str:
    dash = " dashed" if line.dashed else ""
    bottom, top = y_axis.start, y_axis.end
    points = [(x_axis(x), min(max(y_axis(y), top), bottom)) for x, y in line.points]
    if len(points) == 1:
        (x, y), *_ = points
        return f'<circle class="dot tone{line.tone}" cx="{x:.1f}" cy="{y:.1f}" r="3"/>'
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline class="curve tone{line.tone}{dash}" points="{path}"/>'


def _drawable(value: float, log: bool) -> bool:
    return math.isfinite(value) and (value > 0 or not log)


def _padded(low: float, high: float, log: bool) -> tuple[float, float]:
    if log:
        return low * 0.85, high * 1.15
    margin = 0.06 * (high - low) or 0.5
    return low - margin, high + margin


@dataclass(frozen=True)
class Span:
    """A stretch of time of one lane, in seconds from the beginning."""

    name: str
    start: float
    end: float


def spans_of_stages(seconds: dict[str, float]) -> list[Span]:
    """Stages one after the other, as spans."""
    spans, now = [], 0.0
    for name, duration in seconds.items():
        spans.append(Span(name, now, now + duration))
        now += duration
    return spans


def time_line(spans: Sequence[Span]) -> str:
    """One row a stage on a common time axis, as an <svg> element; "" for nothing."""
    spans = [span for span in spans if span.end > span.start]
    if not spans:
        return ""
    names = list(dict.fromkeys(span.name for span in spans))
    total = max(span.end for span in spans)
    width, row, left, right = 960, 30, 150, 80
    height = row * len(names) + 26
    axis = _Axis(0.0, total, left, width - right)
    parts = [
        f'<svg class="chart wide" viewBox="0 0 {width} {height}" role="img" aria-label="time line">'
    ]
    for tick in nice_ticks(0.0, total, 8):
        x = axis(tick)
        parts.append(
            f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{row * len(names)}"/>'
        )
        parts.append(
            f'<text class="tick" x="{x:.1f}" y="{height - 6}" text-anchor="middle">{tick_label(tick)} s</text>'
        )
    for index, name in enumerate(names):
        y = index * row
        mine = [span for span in spans if span.name == name]
        spent = sum(span.end - span.start for span in mine)
        parts.append(
            f'<text class="label" x="{left - 10}" y="{y + 20}" text-anchor="end">{escape(name)}</text>'
        )
        for span in mine:
            x0, x1 = axis(span.start), axis(span.end)
            parts.append(
                f'<rect class="bar" x="{x0:.1f}" y="{y + 6}" width="{max(x1 - x0, 1.5):.1f}" height="18" rx="3"/>'
            )
        parts.append(
            f'<text class="value" x="{axis(mine[-1].end) + 8:.1f}" y="{y + 20}">{duration_text(spent)}</text>'
        )
    parts.append("</svg>")
    return "".join(parts)


def duration_text(seconds: float) -> str:
    """'0.8 s', '42 s', '7 min 05 s', '3 h 10 min'."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
