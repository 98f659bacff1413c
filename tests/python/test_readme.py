"""What README.md shows works: its Python text word for word, its commands with small numbers.

SPDX-License-Identifier: BSD-3-Clause
"""

import re
import shlex
import shutil
from itertools import pairwise

import pytest
from command import ROOT, pave

import pave as library

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
    ]  # fmt: skip
    for name in ("cornell.exr", "drawn.png", "run/generator.safetensors", "run/metrics.csv"):
        assert (folder / name).stat().st_size > 0, name


@pytest.mark.slow
def test_python_sketch(folder, tmp_path, monkeypatch):
    shutil.copytree(folder / "cornell.bp", tmp_path / "cornell.bp")
    shutil.copytree(folder / "run", tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    eye, target = (278, 273, -800), (278, 273, 280)
    copies = library.copies()
    names = {"eye": eye, "target": target}
    exec(block("python", "Python"), names)
    assert len(names["train"]) + len(names["test"]) + len(names["validation"]) == 10
    assert names["train"][0]["albedo"].shape == (3, 32, 32)
    color = names["frame"]["color"]
    assert color.torch().data_ptr() == color.address
    assert color.torch().isfinite().all()
    assert library.copies() == copies
