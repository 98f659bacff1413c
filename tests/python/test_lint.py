"""The lint rules catch what they are for, and leave good code alone.

SPDX-License-Identifier: BSD-3-Clause
"""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
import lint

SPDX = "// SPDX-License-Identifier: BSD-3-Clause\n"


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("host/a.cpp", "// TODO: later"),
        ("kernels/a.cl", "#if 0"),
        ("kernels/a.cl", "#  if 0  // off"),
        ("tests/a.cpp", 'GTEST_SKIP() << "no device";'),
        ("tests/a.cpp", "TEST(Ring, DISABLED_Wraps) {"),
        ("tests/python/a.py", "@pytest.mark.skipif(True, reason='slow')"),
        ("tests/python/a.py", "torch = pytest.importorskip('torch')"),
        ("python/pave/a.py", "state = torch.load(path)"),
        ("python/pave/a.py", "import pickle"),
        ("python/pave/a.py", "subprocess.run(text, shell=True)"),
        ("host/a.cpp", 'if (system("clinfo") != 0) return;'),
    ],
)
def test_a_bad_line_is_found(name, line):
    found = lint.broken_rules(name, SPDX + line + "\n")
    assert len(found) == 1
    assert found[0].startswith(f"{name}:2: ")


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("kernels/a.cl", "#if 0 < PAVE_LANES"),
        ("python/pave/a.py", "state = torch.load(path, weights_only=True)"),
        ("host/a.cpp", "filesystem(path);"),
        ("host/a.cpp", "void skip(); // skips blanks"),
    ],
)
def test_a_good_line_passes(name, line):
    assert lint.broken_rules(name, SPDX + line + "\n") == []


def test_a_source_without_licence_line_is_found():
    assert lint.broken_rules("host/a.cpp", "// A file.\nint a;\n") == [
        "host/a.cpp:1: no SPDX-License-Identifier in the first lines"
    ]


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("host/a.cpp", "// A file. SPDX-License-Identifier: BSD-3-Clause"),
        ("kernels/a.cl", "int a; // SPDX-License-Identifier: BSD-3-Clause"),
        ("python/pave/a.py", '"""A file. SPDX-License-Identifier: BSD-3-Clause'),
        ("a.cmake", "# A file. SPDX-License-Identifier: BSD-3-Clause"),
    ],
)
def test_text_before_the_licence_is_found(name, line):
    found = lint.broken_rules(name, f"\n{line}\n")
    assert len(found) == 1
    assert found[0].startswith(f"{name}:2: the licence line")


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("tests/a.c", "/* SPDX-License-Identifier: BSD-3-Clause */"),
        ("tests/a.c", " * SPDX-License-Identifier: BSD-3-Clause"),
        ("python/pave/a.py", "SPDX-License-Identifier: BSD-3-Clause"),
        ("pave", "# SPDX-License-Identifier: BSD-3-Clause"),
    ],
)
def test_a_licence_line_of_its_own_passes(name, line):
    assert lint.broken_rules(name, f"\n{line}\n") == []


def test_the_list_of_files_holds_this_one_and_no_build():
    names = {path.relative_to(lint.ROOT).as_posix() for path in lint.files()}
    assert "tests/python/test_lint.py" in names
    assert "pave" in names
    assert not any(name.startswith(("build", ".venv")) for name in names)
