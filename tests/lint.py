"""Checks format (clang-format, ruff) and the project's own rules: nothing skipped, switched off or left for later.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCES = (
    "*.cpp",
    "*.c",
    "*.h",
    "*.cl",
    "*.py",
    "*.sh",
    "*.cmake",
    "CMakeLists.txt",
    "pave",
    "*.toml",
)
CODE = {".cpp", ".c", ".h", ".cl", ".py"}

# What users run; tests may make hostile files and call other programs.
PRODUCT = ("python/", "host/", "staging/", "kernels/", "examples/")

# What a line of code may not hold, where, and why.
RULES = [
    (r"\b(TODO|FIXME|XXX)\b", "", "left for later: finish it, or say it in CHANGELOG.md"),
    (r"^\s*#\s*if\s+0\s*($|//|/\*)", "", "code that is switched off: delete it"),
    (r"\bGTEST_SKIP\b|\bDISABLED_\w", "tests/", "a test that does not run: mend it or delete it"),
    (
        r"pytest\.(mark\.)?(skip|skipif|importorskip|xfail)\b|unittest\.skip",
        "tests/",
        "a test that does not run: mend it or delete it",
    ),
    (r"\bimport pickle\b|\bpickle\.loads?\(", PRODUCT, "pickle runs what it reads"),
    (r"torch\.load\((?!.*weights_only=True)", "", "torch.load needs weights_only=True on its line"),
    (
        r"\bshell=True\b|\bos\.system\(|(?<![\w.])system\(",
        PRODUCT,
        "no shell: pass a list of words",
    ),
]


def files() -> list[Path]:
    """Source files under version control, and new ones that are not ignored."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *SOURCES]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    if listed.returncode != 0:
        sys.exit(f"lint: git ls-files failed: {listed.stderr.strip()}")
    return [ROOT / name for name in listed.stdout.splitlines() if (ROOT / name).is_file()]


# The licence line holds nothing but its comment's mark before the tag, and is near the top.
LICENCE = re.compile(r"^\s*(//|/?\*|#)?\s*SPDX-License-Identifier: \S+")
HEAD = 5


def broken_licence(name: str, lines: list[str]) -> list[str]:
    tagged = [n for n, line in enumerate(lines[:HEAD], 1) if "SPDX-License-Identifier" in line]
    if not tagged and Path(name).suffix in CODE:
        return [f"{name}:1: no SPDX-License-Identifier in the first lines"]
    return [
        f"{name}:{n}: the licence line begins with other text: {lines[n - 1].strip()[:80]}"
        for n in tagged
        if not LICENCE.match(lines[n - 1])
    ]


def broken_rules(name: str, text: str) -> list[str]:
    """Findings 'file:line: why' of one file."""
    lines = text.splitlines()
    found = broken_licence(name, lines)
    for number, line in enumerate(lines, 1):
        for pattern, where, why in RULES:
            if name.startswith(where) and re.search(pattern, line):
                found.append(f"{name}:{number}: {why}: {line.strip()[:80]}")
    return found


def own_rules(paths: list[Path]) -> bool:
    own = {"tests/lint.py", "tests/python/test_lint.py"}  # they hold the patterns themselves
    found = []
    for path in paths:
        name = path.relative_to(ROOT).as_posix()
        if name not in own:
            found += broken_rules(name, path.read_text(encoding="utf-8"))
    for line in found:
        print(line)
    return not found


def clang_format(paths: list[Path]) -> bool:
    """True if clang-format would change nothing; names the files that it would change."""
    command = ["clang-format", "--dry-run", "-Werror", *map(str, paths)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    for path in paths:
        if f"{path}:" in done.stderr:
            print(f"{path.relative_to(ROOT)}: run clang-format -i")
    return done.returncode == 0


def tool(*command: str) -> bool:
    return subprocess.run(command, cwd=ROOT, timeout=300).returncode == 0


def main() -> int:
    paths = files()
    cpp = [p for p in paths if p.suffix in (".cpp", ".c", ".h", ".cl")]
    checks = {
        "rules": own_rules(paths),
        "clang-format": clang_format(cpp),
        "ruff check": tool(
            sys.executable, "-m", "ruff", "check", "--output-format", "concise", "--quiet", "."
        ),
        "ruff format": tool(sys.executable, "-m", "ruff", "format", "--check", "--quiet", "."),
    }
    for check, good in checks.items():
        print(f"{'ok    ' if good else 'FAILED'} {check}")
    print(f"lint: {len(paths)} files, {sum(checks.values())} of {len(checks)} checks passed")
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
