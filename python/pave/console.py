"""What the command line says: JSON lines for machines, progress for terminals, one line for errors.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any


def _finite(value: Any) -> Any:
    """JSON has no infinity and no NaN: they become strings, so that every line parses everywhere."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value


class Console:
    """Results go to stdout, everything else to stderr. With `json_lines` a result is one JSON object a line."""

    def __init__(self, json_lines: bool = False) -> None:
        self.json_lines = json_lines
        self.terminal = sys.stderr.isatty() and not json_lines

    def result(self, record: dict[str, Any], text: str | None = None) -> None:
        """Prints one result: the record as JSON, or `text` (default: key and value a line)."""
        if self.json_lines:
            print(json.dumps(_finite(record)), flush=True)
        elif text is not None:
            print(text, flush=True)
        else:
            width = max((len(key) for key in record), default=0)
            for key, value in record.items():
                shown = json.dumps(_finite(value)) if isinstance(value, (dict, list)) else value
                print(f"{key:<{width}}  {shown}", flush=True)

    def event(self, record: dict[str, Any]) -> None:
        """A line of progress that machines may follow; people see it as a progress bar instead."""
        if self.json_lines:
            print(json.dumps(_finite(record)), flush=True)

    def say(self, text: str) -> None:
        """A remark for people."""
        print(text, file=sys.stderr, flush=True)

    def warn(self, remarks: Iterable[str]) -> None:
        """A line each for people; what they are about goes on all the same."""
        for remark in remarks:
            self.say(f"pave: warning: {remark}")

    @contextmanager
    def progress(self, title: str, total: float, unit: str = "") -> Iterator[Progress]:
        """A bar with rate and ETA on a terminal; nothing in a pipe but a line at the end."""
        bar = Progress(title, total, unit, self.terminal)
        try:
            yield bar
        finally:
            bar.close()
        if not self.json_lines and not self.terminal:
            self.say(f"{title}: {bar.summary()}")

    @contextmanager
    def counted(self, stage: str, unit: str) -> Iterator[Callable[[int, int], None]]:
        """A bar and events for work of many like steps: call what it yields with (done, total) after each."""
        with self.progress(stage, 1, unit) as bar:

            def step(done: int, total: int) -> None:
                bar.total = total
                bar.update(done)
                self.event({"stage": stage, unit: done, "of": total})

            yield step


class Progress:
    """One bar. `update(done, note)` may be called as often as one likes; `total` may change in between.

    Rates are of what was done since the first update: what an earlier call did took no time of this one.
    """

    def __init__(self, title: str, total: float, unit: str, visible: bool) -> None:
        self.title, self.total, self.unit = title, total, unit
        self.begin = time.monotonic()
        self.first: tuple[float, float] | None = None  # done and time of the first update
        self.done = 0.0
        self._bar: Any = None
        self._task: Any = None
        if visible:
            from rich.console import Console as RichConsole
            from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
            from rich.progress import Progress as RichProgress

            self._bar = RichProgress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed:.0f}/{task.total:.0f} " + unit),
                TextColumn("{task.fields[rate]}"),
                TextColumn("ETA"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}"),
                console=RichConsole(stderr=True),
            )
            self._bar.start()
            self._task = self._bar.add_task(title, total=total, rate="", note="")

    @property
    def rate(self) -> float | None:
        """Units a second since the first update; None if nothing was done since."""
        if self.first is None or self.done <= self.first[0]:
            return None
        return (self.done - self.first[0]) / max(time.monotonic() - self.first[1], 1e-9)

    def update(self, done: float, note: str = "") -> None:
        self.done = done
        begins = self.first is None
        if begins:
            self.first = (done, time.monotonic())
        if self._bar is not None:
            # reset() at the first, so that the bar's own ETA too leaves out what was done before.
            show = self._bar.reset if begins else self._bar.update
            rate = self._rate_text()
            show(self._task, total=self.total, completed=done, rate=rate, note=note)

    def _rate_text(self) -> str:
        return "" if self.rate is None else f"{self.rate:.2f} {self.unit}/s"

    def summary(self) -> str:
        seconds = time.monotonic() - self.begin
        rate = f" ({self._rate_text()})" if self.rate is not None else ""
        return f"{self.done:g} {self.unit} in {seconds:.1f} s{rate}"

    def close(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
