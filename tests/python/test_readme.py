"""What README.md shows works: its Python text word for word, its commands with small numbers.

SPDX-License-Identifier: BSD-3-Clause
"""

import re
import shlex
from itertools import pairwise

import pytest
from command import ROOT, pave
from test_sketch import SKETCH

TEXT = (ROOT / "README.md").read_text()
SMALL = {"--views": "10", "--size": "32x32", "--spp": "4"}


def block(language, section):
    """The first code block of `language` in a section."""
    text = TEXT.split(f"\n## {section}\n", 1)[1]
    return re.search(rf"```{language}\n(.*?)```", text, re.S).group(1)


def commands():
    """Arguments of every `./pave` line under Commands, comments dropped, sizes made small."""
    found = []
    for line in block("sh", "Commands").splitlines():
        words = shlex.split(line, comments=True)
        assert words[0] == "./pave"
        found.append([SMALL.get(before, word) for before, word in pairwise(words)])
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the commands of README.md ran, one after the other."""
    path = tmp_path_factory.mktemp("readme")
    for words in commands():
        extra = ["--epochs", "1", "--filters", "4"] if words[0] == "train" else []
        done = pave(*words, *extra, cwd=path)
        assert done.code == 0, f"pave {' '.join(words)}: {done.err}"
    return path


@pytest.mark.slow
def test_commands(folder):
    assert [words[0] for words in commands()] == [
        "doctor", "devices", "render", "dataset", "info", "train", "evaluate", "infer",
        "bench",
    ]  # fmt: skip
    for name in ("cornell.exr", "drawn.png", "run/generator.safetensors", "run/metrics.csv"):
        assert (folder / name).stat().st_size > 0, name


def test_python_sketch_is_the_one_that_runs():
    def lines(text: str) -> list[str]:
        return [line for line in text.splitlines() if line.strip()]

    assert lines(block("python", "Python")) == lines(SKETCH)
