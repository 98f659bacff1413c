"""Progress as people and machines see it.

SPDX-License-Identifier: BSD-3-Clause
"""

import json

import pytest

from pave import console as module
from pave.console import Console, Progress


@pytest.fixture
def clock(monkeypatch):
    """A clock that tests set by hand."""

    class Clock:
        now = 100.0

        def monotonic(self):
            return self.now

    fake = Clock()
    monkeypatch.setattr(module, "time", fake)
    return fake


@pytest.mark.parametrize("before", [0, 400])
def test_rate_is_of_this_call_alone(clock, before):
    bar = Progress("train", 1000, "steps", visible=False)
    clock.now += 7.0  # until the work begins
    bar.update(before)
    assert bar.rate is None
    clock.now += 4.0
    bar.update(before + 20)
    assert bar.rate == pytest.approx(5.0)
    assert bar.summary() == f"{before + 20} steps in 11.0 s (5.00 steps/s)"


def test_no_rate_where_nothing_was_done(clock):
    bar = Progress("train", 10, "steps", visible=False)
    assert bar.summary() == "0 steps in 0.0 s"
    bar.update(10)
    clock.now += 2.0
    assert bar.summary() == "10 steps in 2.0 s"


def test_a_bar_on_a_terminal_starts_where_the_work_does(clock, capsys):
    bar = Progress("train", 1000, "steps", visible=True)
    bar.update(400)
    clock.now += 2.0
    bar.update(410, "epoch 3/5")
    task = bar._bar.tasks[0]
    assert (task.completed, task.total) == (410, 1000)
    assert (task.fields["rate"], task.fields["note"]) == ("5.00 steps/s", "epoch 3/5")
    assert sum(sample.completed for sample in task._progress) == 10  # what its ETA is made from
    bar.close()


def test_counted_work_tells_machines_each_step(capsys):
    with Console(json_lines=True).counted("evaluate", "images") as step:
        step(1, 2)
        step(2, 2)
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert records == [{"stage": "evaluate", "images": done, "of": 2} for done in (1, 2)]
    with Console().counted("evaluate", "images") as step:
        step(1, 2)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("evaluate: 1 images in ")
