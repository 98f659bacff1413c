"""Runs every test and says how it went: lint, C++ (ctest), Python (pytest). `./pave test` sets up and calls this.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build"
PART_LIMIT_S = 1800  # one part; single tests have shorter limits of their own
PYTEST_FOUND_NONE = 5


@dataclass
class Part:
    """One runner and what came of it."""

    name: str
    command: list[str]
    report: Path | None = None  # JUnit file that the runner writes
    passed: int = 0
    failed: int = 0
    skipped: int = 0
    seconds: float = 0.0
    status: int = 0
    failures: list[str] = field(default_factory=list)

    def run(self) -> None:
        """Runs the command with its output going straight through, then counts."""
        print(f"\n== {self.name}", flush=True)
        if self.report is not None:
            self.report.unlink(missing_ok=True)
        begin = time.monotonic()
        try:
            self.status = subprocess.run(self.command, cwd=ROOT, timeout=PART_LIMIT_S).returncode
        except subprocess.TimeoutExpired:
            print(f"{self.name}: stopped after {PART_LIMIT_S} s", flush=True)
            self.status = 124
        self.seconds = time.monotonic() - begin
        if self.report is None:
            self.passed, self.failed = int(self.status == 0), int(self.status != 0)
        elif self.report.exists():
            self._count(self.report)

    def _count(self, report: Path) -> None:
        for case in ET.parse(report).iter("testcase"):
            if case.find("failure") is not None or case.find("error") is not None:
                self.failed += 1
                self.failures.append(f"{case.get('classname')} {case.get('name')}")
            elif case.find("skipped") is not None:
                self.skipped += 1
            else:
                self.passed += 1

    @property
    def empty(self) -> bool:
        """Nothing ran, and nothing went wrong: no test has a name that was asked for."""
        nothing = self.passed + self.failed + self.skipped == 0
        return nothing and self.status in (0, PYTEST_FOUND_NONE)

    @property
    def good(self) -> bool:
        return self.status == 0 and self.failed == 0 and self.passed > 0

    def summary(self) -> str:
        mark = "ok    " if self.good else "none  " if self.empty else "FAILED"
        return (
            f"{mark} {self.name:<8} {self.passed} passed, {self.failed} failed, "
            f"{self.skipped} skipped in {self.seconds:.0f} s"
        )


def parts_of(options: argparse.Namespace) -> list[Part]:
    """The runners that `options` ask for, in the order of their cost."""
    marks = "faults" if options.faults else "not faults and not cycles"
    if options.fast:
        marks += " and not slow"
    ctest = ["ctest", "--test-dir", str(BUILD), "--output-on-failure"]
    ctest += [f"--no-tests={'ignore' if options.filter else 'error'}"]
    ctest += ["--output-junit", str(BUILD / "ctest.xml"), "-j", str(min(os.cpu_count() or 1, 4))]
    ctest += ["-LE", "slow"] if options.fast else []
    ctest += ["-R", options.filter] if options.filter else []
    pytest = [sys.executable, "-m", "pytest", "-m", marks]
    pytest += [f"--junitxml={BUILD / 'pytest.xml'}", "tests/python"]
    pytest += ["-k", options.filter] if options.filter else []
    parts = {
        "lint": Part("lint", [sys.executable, str(ROOT / "tests" / "lint.py")]),
        "cpp": Part("C++", ctest, BUILD / "ctest.xml"),
        "python": Part("Python", pytest, BUILD / "pytest.xml"),
    }
    if options.faults:
        return [parts["python"]]
    if options.seeded:
        seeded = [sys.executable, str(ROOT / "tests" / "seeded_bugs.py")]
        return [Part("seeded", seeded + (["-k", options.filter] if options.filter else []))]
    if options.only:
        return [parts[options.only]]
    if options.filter:  # lint has no names
        del parts["lint"]
    return list(parts.values())


def all_good(parts: list[Part], filtered: bool) -> bool:
    """Whether nothing failed and something ran. Only with a filter may a part find nothing to run."""
    if any(not (part.good or (filtered and part.empty)) for part in parts):
        return False
    return any(part.good for part in parts)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="./pave test", description=__doc__.split("\n")[0])
    parser.add_argument("--fast", action="store_true", help="leave the slow tests out")
    parser.add_argument("--faults", action="store_true", help="only the long kill and fault tests")
    parser.add_argument(
        "--seeded", action="store_true", help="only: plant physics bugs, which tests must notice"
    )
    parser.add_argument("--only", choices=["lint", "cpp", "python"], help="one part alone")
    parser.add_argument(
        "-k", "--filter", help="tests whose names match (ctest: regex, pytest: expression)"
    )
    options = parser.parse_args(arguments)
    parts = parts_of(options)
    for part in parts:
        part.run()
    print("\n== summary")
    for part in parts:
        print(part.summary())
        for name in part.failures:
            print(f"       {name}")
    good = all_good(parts, filtered=bool(options.filter))
    if all(part.empty for part in parts):
        print(f"no test matches {options.filter}")
    print("all tests passed" if good else "TESTS FAILED", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
