"""What `./pave test` runs for which options, and when it says that all is well.

SPDX-License-Identifier: BSD-3-Clause
"""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
import run as runner

RESULT = """import sys, pathlib
pathlib.Path({report!r}).write_text("<testsuite>" + {cases!r} + "</testsuite>")
sys.exit({status})
"""
PASSED = "<testcase classname='a' name='b'/>"
FAILED = "<testcase classname='a' name='b'><failure/></testcase>"


@pytest.fixture
def stand_ins(monkeypatch, tmp_path):
    """Replaces ctest and pytest by programs that report what the test says: name -> (cases, exit status)."""
    given = {}

    def parts_of(options):
        seen = real(options)
        for part in seen:
            cases, status = given.get(part.name, (PASSED, 0))
            report = tmp_path / f"{part.name}.xml"
            text = RESULT.format(report=str(report), cases=cases, status=status)
            part.command, part.report = [sys.executable, "-c", text], report
        return seen

    real = runner.parts_of
    monkeypatch.setattr(runner, "parts_of", parts_of)
    return given


def commands(monkeypatch, *arguments):
    """Command line of each part that would run, by its name."""
    found = {}
    monkeypatch.setattr(
        runner.Part, "run", lambda part: found.update({part.name: " ".join(part.command)})
    )
    runner.main(list(arguments))
    return found


def test_everything_but_the_fault_loops_runs_by_default(monkeypatch):
    found = commands(monkeypatch)
    assert list(found) == ["lint", "C++", "Python"]
    assert "-LE" not in found["C++"]
    assert "--no-tests=error" in found["C++"]
    assert "-m not faults and not cycles " in found["Python"]
    assert "slow" not in found["Python"]


def test_fast_leaves_the_slow_ones_out(monkeypatch):
    found = commands(monkeypatch, "--fast")
    assert "-LE slow" in found["C++"]
    assert "-m not faults and not cycles and not slow " in found["Python"]


def test_parts_can_be_chosen(monkeypatch):
    assert list(commands(monkeypatch, "--only", "cpp")) == ["C++"]
    assert list(commands(monkeypatch, "--faults")) == ["Python"]
    found = commands(monkeypatch, "-k", "ring")
    assert list(found) == ["C++", "Python"]
    assert "-R ring" in found["C++"]
    assert found["Python"].endswith("-k ring")


NONE_OF_PYTEST = ("", runner.PYTEST_FOUND_NONE)
NONE_OF_CTEST = ("", 0)


@pytest.mark.parametrize(
    ("arguments", "given", "status"),
    [
        ([], {}, 0),
        ([], {"Python": (FAILED, 1)}, 1),
        ([], {"Python": (PASSED, 3)}, 1),
        ([], {"Python": NONE_OF_PYTEST}, 1),
        (["-k", "x"], {"Python": NONE_OF_PYTEST}, 0),
        (["-k", "x"], {"C++": NONE_OF_CTEST}, 0),
        (["-k", "x"], {"C++": NONE_OF_CTEST, "Python": NONE_OF_PYTEST}, 1),
        (["-k", "x"], {"C++": NONE_OF_CTEST, "Python": (FAILED, 1)}, 1),
        (["-k", "x"], {"C++": (PASSED, 0), "Python": ("", 2)}, 1),
    ],
)
def test_all_is_well_if_nothing_failed_and_something_ran(stand_ins, arguments, given, status):
    stand_ins.update(given)
    assert runner.main(arguments) == status


def test_the_summary_counts_and_names(stand_ins, capsys):
    stand_ins["Python"] = (PASSED + FAILED, 1)
    runner.main([])
    out = capsys.readouterr().out
    assert "FAILED Python   1 passed, 1 failed" in out
    assert out.rstrip().endswith("TESTS FAILED")
