"""`pave demo`: the papers' experiment in small, from nothing to a report, and on from where it was stopped.

SPDX-License-Identifier: BSD-3-Clause
"""

import json
import math
import signal
import time

import pytest
from command import pave, start

import pave as library

QUICK_LIMIT_S = 180  # on two cores that nobody else uses; the test allows twice that


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Folder and record of one quick demo, interrupted in its training once."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    begin = time.monotonic()
    process = start("demo", folder, "--quick", "--json")
    for line in process.stdout:
        if json.loads(line).get("stage") == "train":
            process.send_signal(signal.SIGINT)
            break
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1, err
    outcome = pave("demo", folder, "--quick", "--json", limit_s=2 * QUICK_LIMIT_S)
    assert outcome.code == 0, outcome.err
    return folder, outcome, time.monotonic() - begin


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_quick_demo(demo):
    folder, outcome, seconds = demo
    assert seconds < 2 * QUICK_LIMIT_S
    record = outcome.records[-1]
    for key in ("psnr", "ssim", "baseline_psnr", "novel_psnr", "d_real", "d_fake"):
        assert math.isfinite(record[key]), key
    assert all(value >= 0 for value in record["seconds"].values())
    # Some hundred steps on small images learn less than the full demo, but more than nothing.
    assert record["psnr"] > record["baseline_psnr"]
    for name in ("report.html", "run/generator.safetensors", "run/generator.json", "run/loss.png"):
        assert (folder / name).stat().st_size > 0, name
    assert library.Source(f"bp:{folder / 'cornell.bp'}").finished
    assert library.Source(f"bp:{folder / 'novel.bp'}").finished


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_report_stands_alone(demo):
    from pave.report import check_report

    assert check_report(demo[0] / "report.html") == []


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_second_call_renders_and_trains_nothing(demo):
    folder, first, _ = demo
    begin = time.monotonic()
    again = pave("demo", folder, "--quick", "--json", limit_s=QUICK_LIMIT_S)
    assert again.code == 0, again.err
    assert time.monotonic() - begin < QUICK_LIMIT_S / 2
    assert again.records[-1]["psnr"] == pytest.approx(first.records[-1]["psnr"], abs=1e-6)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_folder_of_other_settings_is_left_alone(demo):
    outcome = pave("demo", demo[0], "--quick", "--seed", "9")
    assert outcome.code == 2, outcome.err
    assert str(demo[0]) in outcome.err
