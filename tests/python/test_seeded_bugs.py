"""The list of planted bugs fits the kernels, and its runner tells bugs from what changes nothing.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import importlib.util
import shutil
import sys
from pathlib import Path
from types import ModuleType

import pytest

TESTS = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def seeded() -> ModuleType:
    spec = importlib.util.spec_from_file_location("seeded_bugs", TESTS / "seeded_bugs.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_every_bug_can_be_planted(seeded: ModuleType, tmp_path: Path) -> None:
    assert len(seeded.BUGS) >= 25
    assert len({bug.name for bug in seeded.BUGS}) == len(seeded.BUGS)
    for number, bug in enumerate(seeded.BUGS):
        kernels = tmp_path / str(number)
        shutil.copytree(seeded.KERNELS, kernels)
        bug.plant(kernels)  # raises if the text has moved on


def test_a_bug_is_caught_and_a_harmless_change_escapes(
    seeded: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (roulette,) = [bug for bug in seeded.BUGS if bug.name == "roulette without division"]
    assert seeded.sound_kernels_pass(roulette.tests, tmp_path)
    assert seeded.report(seeded.try_bug(roulette, tmp_path))
    harmless = seeded.Bug(
        "a comment", roulette.file, "// The path tracer:", "// A tracer:", roulette.tests
    )
    assert not seeded.report(seeded.try_bug(harmless, tmp_path))
    broken = seeded.Bug("no C", roulette.file, "// The path tracer:", "(", roulette.tests)
    assert not seeded.report(seeded.try_bug(broken, tmp_path))
    printed = capsys.readouterr().out
    assert "nothing noticed it" in printed
    assert "do not compile" in printed
