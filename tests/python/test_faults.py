"""`kill -9` at random moments of `pave dataset`: exactly what was acknowledged is there, and --resume mends the rest.

SPDX-License-Identifier: BSD-3-Clause
"""

import json
import random
import shutil
import time

import pytest
from command import pave, start

import pave as library

VIEWS = 40
ARGUMENTS = (
    "--views", VIEWS, "--size", "16x16", "--spp", "2", "--max-depth", "4", "--seed", "11",
    "--slots", "4", "--frames-per-shard", "4", "--json",
)  # fmt: skip


def manifest(folder):
    return (folder / "manifest.jsonl").read_bytes()


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """The manifest of a run that nobody killed, and its content hash."""
    folder = tmp_path_factory.mktemp("unbroken") / "d.bp"
    done = pave("dataset", "cornell", f"bp:{folder}", *ARGUMENTS)
    assert done.code == 0, done.err
    assert done.records[-1]["acknowledged"] == VIEWS
    return manifest(folder), library.Source(f"bp:{folder}").content_hash


def kill_once(folder, chance):
    """Starts or resumes the data set and kills it. Returns the last acknowledged count that it told."""
    process = start("dataset", "cornell", f"bp:{folder}", *ARGUMENTS, "--resume")
    told = 0
    try:
        if chance.random() < 0.2:  # while it starts
            time.sleep(chance.uniform(0.0, 2.0))
        else:  # some frames later, at any moment of rendering or writing
            for _ in range(chance.randrange(1, VIEWS // 3)):
                line = process.stdout.readline()
                if not line:
                    break
                told = json.loads(line).get("acknowledged", told)
            time.sleep(chance.uniform(0.0, 0.05))
    finally:
        process.kill()
        rest, _ = process.communicate(timeout=60)
    for line in rest.splitlines(keepends=True):
        if line.endswith("\n"):
            told = json.loads(line).get("acknowledged", told)
    return told


def check_whole(folder, told, where):
    """Every acknowledged frame is there and whole; nothing else shows."""
    if not (folder / "manifest.jsonl").exists():
        assert told == 0, where
        return
    source = library.Source(f"bp:{folder}", allow_unfinished=True)
    assert told <= len(source) <= VIEWS, where
    for position in range(len(source)):
        assert source.read(position).metadata["index"] == position, where


def kill_loop(tmp_path, unbroken, kills, seed):
    chance = random.Random(seed)
    killed, rounds = 0, 0
    while killed < kills:
        folder = tmp_path / f"d{rounds}.bp"
        where = f"seed {seed}, data set {rounds}, kill {killed}"
        for _ in range(min(kills - killed, 5)):
            told = kill_once(folder, chance)
            killed += 1
            check_whole(folder, told, where)
        done = pave("dataset", "cornell", f"bp:{folder}", *ARGUMENTS, "--resume")
        assert done.code == 0, f"{where}: {done.err}"
        assert done.records[-1]["acknowledged"] == VIEWS, where
        assert manifest(folder) == unbroken[0], where
        assert library.Source(f"bp:{folder}").content_hash == unbroken[1], where
        shutil.rmtree(folder)
        rounds += 1


@pytest.mark.slow
def test_five_kills(tmp_path, unbroken):
    kill_loop(tmp_path, unbroken, kills=5, seed=1)


@pytest.mark.faults
@pytest.mark.timeout(1800)
def test_fifty_kills(tmp_path, unbroken):
    kill_loop(tmp_path, unbroken, kills=50, seed=2)
