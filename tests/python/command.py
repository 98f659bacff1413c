"""Runs the command line as users do, in a process of its own.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
LIMIT_S = 300  # a safety net for busy machines, not a measure of speed
PAVE = [sys.executable, "-m", "pave"]


def environment(**changes: str | None) -> dict[str, str]:
    """This process's environment with `changes`; None removes a variable."""
    values = {**os.environ, "PYTHONPATH": str(ROOT / "python"), **changes}
    values.pop("PAVE_DEBUG", None)
    return {key: value for key, value in values.items() if value is not None}


@dataclass
class Outcome:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def records(self) -> list[dict[str, Any]]:
        """The JSON objects on stdout; raises if a line is none."""
        return [json.loads(line) for line in self.out.splitlines()]


def pave(
    *arguments: Any, cwd: Path | None = None, limit_s: float = LIMIT_S, **changes: str | None
) -> Outcome:
    """Runs `pave ARGUMENTS`. Other keyword arguments are environment variables."""
    done = subprocess.run(
        [*PAVE, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=limit_s,
        cwd=cwd,
        env=environment(**changes),
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


def start(*arguments: Any, cwd: Path | None = None, **changes: str | None) -> subprocess.Popen:
    """Starts `pave ARGUMENTS` with pipes, for tests that interrupt it."""
    return subprocess.Popen(
        [*PAVE, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env=environment(**changes),
    )
