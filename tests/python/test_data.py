"""The same samples from mem:, bp: and exr:, the papers' verbs, the split, workers, and what wrong use is told.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import hashlib
import threading
from multiprocessing.reduction import ForkingPickler  # what hands objects to spawned workers
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import pave
from pave.data import split_indices

WIDTH, HEIGHT = 24, 16
CHANNELS = ["albedo", "direct", "normal", "depth", "color", ("heat", 2)]
NAMES = ["albedo", "direct", "normal", "depth", "color", "heat"]
FRAMES = 7


def fill(frame: pave.Frame, index: int) -> None:
    """Pixels that only this frame and channel have: every sign, large values, and misses at +inf."""
    for number, name in enumerate(frame):
        generator = np.random.Generator(np.random.PCG64([index, number]))
        frame[name].numpy()[:] = generator.normal(0, 10, frame[name].shape).astype(np.float32)
    frame["depth"].numpy()[0, :2] = np.inf
    frame.metadata.update(
        index=index, scene="made-up", seed=2**63 + index, spp=index + 1, rr_depth=index
    )


def write(uri: str, frames: int = FRAMES, **options) -> pave.Stage:
    """A stage that holds `frames` frames; mem: stays open, files are closed."""
    stage = pave.Stage(
        None, uri, width=WIDTH, height=HEIGHT, channels=CHANNELS, slots=frames + 1, **options
    )
    for index in range(frames):
        frame = stage.acquire()
        fill(frame, index)
        stage.publish(frame)
    stage.flush() if uri.startswith("mem:") else stage.close()
    return stage


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """The same frames in all three places; the stage of mem: must live as long."""
    folder = tmp_path_factory.mktemp("places")
    uris = {"mem": "mem:data", "bp": f"bp:{folder}/data.bp", "exr": f"exr:{folder}/data"}
    stages = [write(uri) for uri in uris.values()]
    yield uris
    stages[0].close()


PLACES = ["mem", "bp", "exr"]


def digest(samples) -> str:
    """SHA-256 over every pixel of every channel of every sample, in order."""
    sha = hashlib.sha256()
    for sample in samples:
        for name, tensor in sample.items():
            assert tensor.dtype == torch.float32
            sha.update(f"{name} {tuple(tensor.shape)} ".encode())
            sha.update(tensor.contiguous().numpy().tobytes())
    return sha.hexdigest()


def expected() -> str:
    frames = []
    for index in range(FRAMES):
        frame = pave.make_frame(None, WIDTH, HEIGHT, CHANNELS)
        fill(frame, index)
        frames.append({name: frame[name].torch() for name in NAMES})
    return digest(frames)


@pytest.mark.parametrize("place", PLACES)
def test_same_samples_from_every_place(places, place):
    before = pave.copies()
    with pave.DataLoader(places[place]) as loader:
        loader.open(NAMES)
        assert len(loader) == FRAMES
        assert digest(loader) == expected()
        assert digest(pave.Dataset(places[place], NAMES)) == expected()
        split = loader.get_split()
        merged = {i: part[n] for part in split for n, i in enumerate(part.indices)}
        assert digest(merged[i] for i in range(FRAMES)) == expected()
    assert pave.copies() == before


@pytest.mark.parametrize("place", PLACES)
def test_same_metadata_and_content_hash_from_every_place(places, place):
    with pave.Source(places[place]) as source:
        assert source.channels == NAMES
        assert source.planes["heat"] == 2
        first = dict(source.metadata(3))
        with pave.Source(places["mem"]) as other:
            assert first == dict(other.metadata(3))
            assert source.content_hash == other.content_hash
        assert first["seed"] == 2**63 + 3
        assert first["rr_depth"] == 3
        assert dict(source.read(3).metadata) == first
        assert source.finished == (place != "mem")
    with pytest.raises(pave.UsageError, match="closed"):
        source.read(0)


def test_mem_samples_are_the_slots_themselves():
    stage = pave.Stage(None, "mem:slots", width=8, height=8, channels=["color"], slots=2)
    frame = stage.acquire()
    tensor = frame["color"].torch()
    stage.publish(frame)
    stage.flush()
    loader = pave.DataLoader("mem:slots").open("color")
    assert loader[0]["color"].data_ptr() == tensor.data_ptr()
    stage.close()


def test_papers_listing_in_situ_and_read():
    """open() sees what is staged so far, read() what came since; the loader is itself a torch data set."""
    stage = write("mem:listing", frames=2)
    loader = pave.DataLoader("mem:listing")
    batches = torch.utils.data.DataLoader(dataset=loader, batch_size=2)
    assert [batch["heat"].shape for batch in batches] == [(2, 2, HEIGHT, WIDTH)]
    loader.open(["direct", "color"])
    frame = stage.acquire()
    fill(frame, 2)
    stage.publish(frame)
    stage.flush()
    assert len(loader) == 2
    dataset = loader.read()
    assert len(dataset) == len(loader) == 3
    assert dataset.channels == loader.channels == ("direct", "color")
    loader.close()
    assert dataset[2]["color"].shape == (3, HEIGHT, WIDTH)
    for use in (loader.read, loader.get_split, loader.__len__, lambda: loader.get(0)):
        with pytest.raises(pave.UsageError, match="closed"):
            use()
    assert len(loader.open()) == 3
    stage.close()


@pytest.mark.parametrize("place", PLACES)
def test_get_by_number_and_by_name(places, place):
    loader = pave.DataLoader(places[place]).open(["normal", "depth"])
    sample = loader.get(4)
    assert list(sample) == ["normal", "depth"]
    before = pave.copies()
    stacked = loader.get("heat")
    assert stacked.shape == (FRAMES, 2, HEIGHT, WIDTH)
    assert pave.copies() == before + FRAMES
    assert torch.equal(loader.get("depth")[4], sample["depth"])
    with pytest.raises(IndexError):
        loader.get(FRAMES)
    with pytest.raises(pave.UsageError, match="no channel 'colour'"):
        loader.get("colour")


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("wrong", [["albedo", "colour"], "colour", [], ["color", "color"]])
def test_wrong_channels_are_usage_errors_that_list_the_right_ones(places, place, wrong):
    loader = pave.DataLoader(places[place])
    for use in (loader.open, lambda names: pave.Dataset(places[place], names)):
        with pytest.raises(pave.UsageError) as caught:
            use(wrong)
        assert caught.value.exit_code == 2
        if "colour" in wrong:
            assert "it has albedo, direct, normal, depth, color, heat" in str(caught.value)


def test_wrong_places_and_indices(places, tmp_path):
    for uri in ("mem:nobody", "zip:data", "data", "mem:"):
        with pytest.raises(pave.UsageError):
            pave.DataLoader(uri).open()
    with pytest.raises(pave.Error) as caught:
        pave.DataLoader(f"bp:{tmp_path}/none.bp").open()
    assert caught.value.exit_code in (2, 3)
    with pytest.raises(pave.UsageError, match="no position 7"):
        pave.Dataset(places["bp"], "color", indices=[0, 7])
    with pytest.raises(pave.UsageError, match="cache_bytes"):
        pave.Dataset(places["bp"], "color", cache_bytes=-1)
    assert pave.Dataset(places["bp"], "color", indices=[6, 2]).metadata(0)["index"] == 6


def test_unfinished_and_damaged_files(tmp_path):
    uri = f"bp:{tmp_path}/open.bp"
    stage = pave.Stage(None, uri, width=8, height=8, channels=["color"], frames_per_shard=1)
    stage.publish(stage.acquire())
    stage.flush()
    with pytest.raises(pave.InputError):
        pave.DataLoader(uri).open()
    assert len(pave.DataLoader(uri, allow_unfinished=True).open()) == 1
    stage.close()
    payload = max(Path(uri[3:]).rglob("*"), key=lambda p: p.stat().st_size if p.is_file() else 0)
    damaged = bytearray(payload.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    payload.write_bytes(damaged)
    with pytest.raises(pave.InputError) as caught:
        pave.DataLoader(uri).open()[0]
    assert caught.value.exit_code == 3
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("place", ["bp", "exr"])
def test_the_cache_keeps_what_fits(places, place):
    frame_bytes = pave.Source(places[place]).frame_byte_size
    kept = pave.Dataset(places[place], "color", cache_bytes=2 * frame_bytes)
    first = [kept[i]["color"] for i in range(FRAMES)]
    again = [kept[i]["color"] for i in range(FRAMES)]
    same = [a.data_ptr() == b.data_ptr() for a, b in zip(first, again, strict=True)]
    assert same == [True, True] + [False] * (FRAMES - 2)
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    none = pave.Dataset(places[place], "color", cache_bytes=0)
    held = none[0]["color"]
    assert none[0]["color"].data_ptr() != held.data_ptr()


@pytest.mark.parametrize("place", PLACES)
def test_forked_workers_give_the_same_samples(places, place):
    """Frames that the parent has read, and frames that a worker has to read from files of its own."""
    dataset = pave.Dataset(places[place], NAMES)
    parent = [dataset[i] for i in range(3)]
    loader = torch.utils.data.DataLoader(
        dataset, batch_size=None, num_workers=2, multiprocessing_context="fork", timeout=60
    )
    for _ in range(2):
        assert digest(loader) == expected()
    assert digest(parent) == digest(dataset[i] for i in range(3))
    assert digest(dataset) == expected()


def test_workers_are_forked_while_others_read(places):
    """A fork in the middle of another thread's call into ADIOS2 leaves its worker able to read."""
    done = threading.Event()

    def read() -> None:
        while not done.is_set():
            with pave.Source(places["bp"]) as source:
                source.read(0)

    reader = threading.Thread(target=read)
    reader.start()
    try:
        for _ in range(5):
            dataset = pave.Dataset(places["bp"], NAMES)
            first = dataset[0]  # so that the workers inherit files that the parent has open
            loader = torch.utils.data.DataLoader(
                dataset, batch_size=None, num_workers=2, multiprocessing_context="fork", timeout=25
            )
            assert digest(loader) == expected()
            assert first
    finally:
        done.set()
        reader.join(timeout=60)
    assert not reader.is_alive()


def test_opening_sees_one_moment_of_a_store_that_others_take_from():
    stage = pave.Stage(None, "mem:taken", width=4, height=4, channels=["depth"], slots=2000)
    for _ in range(2000):
        frame = stage.acquire()
        stage.publish(frame)
        frame.release()
    stage.close()

    def take() -> None:
        with pave.Source("mem:taken") as source:
            while source.next(timeout=20) is not None:
                pass

    taker = threading.Thread(target=take)
    taker.start()
    while count := len(dataset := pave.Dataset("mem:taken")):
        indices = [dataset.metadata(i)["index"] for i in range(count)]
        assert indices == list(range(2000 - count, 2000))
        del dataset
    taker.join(timeout=60)
    assert not taker.is_alive()


@pytest.mark.parametrize("place", ["bp", "exr"])
def test_a_spawned_worker_opens_the_files_anew(places, place):
    dataset = pave.Dataset(places[place], NAMES, indices=[5, 1])
    copy = ForkingPickler.loads(ForkingPickler.dumps(dataset))
    assert copy.indices == (5, 1)
    assert digest(copy) == digest(dataset)


def test_mem_cannot_go_to_a_spawned_worker(places):
    with pytest.raises(pave.UsageError, match="one process"):
        ForkingPickler.dumps(pave.Dataset(places["mem"], NAMES))


def test_two_threads_share_a_data_set(places):
    from concurrent.futures import ThreadPoolExecutor

    dataset = pave.Dataset(places["bp"], NAMES, cache_bytes=0)
    wanted = [digest([dataset[i]]) for i in range(FRAMES)]
    order = [i % FRAMES for i in range(5 * FRAMES)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda i: digest([dataset[i]]), order))
    assert found == [wanted[i] for i in order]


@settings(deadline=None, max_examples=60, derandomize=True)
@given(count=st.integers(0, 400), seed=st.integers(0, 2**64))
def test_split_is_disjoint_complete_and_repeatable(count, seed):
    train, test, validation = split_indices(count, seed)
    assert sorted(train + test + validation) == list(range(count))
    assert split_indices(count, seed) == (train, test, validation)
    assert abs(len(test) - 0.2 * count) <= 0.5
    assert abs(len(validation) - 0.2 * count) <= 0.5
    assert abs(len(train) - 0.6 * count) <= 1
    for part in (train, test, validation):
        assert part == sorted(part)


@settings(deadline=None, max_examples=30, derandomize=True)
@given(
    count=st.integers(0, 60),
    shares=st.tuples(st.integers(0, 9), st.integers(0, 9), st.integers(1, 9)),
)
def test_split_with_any_fractions(count, shares):
    fractions = [share / sum(shares) for share in shares]
    parts = split_indices(count, 3, fractions)
    assert sorted(i for part in parts for i in part) == list(range(count))


def test_split_depends_on_the_seed_and_is_the_papers():
    sizes = [len(part) for part in split_indices(3080)]
    assert sizes == [1848, 616, 616]
    assert split_indices(100, 1) != split_indices(100, 2)
    # Pinned: a data set split yesterday is split the same tomorrow and elsewhere.
    assert split_indices(10, 0)[1:] == PINNED
    for wrong in ((0.5, 0.5), (0.6, 0.6, -0.2), (0.5, 0.2, 0.2)):
        with pytest.raises(pave.UsageError, match="three fractions"):
            split_indices(10, 0, wrong)


PINNED = ([3, 8], [2, 7])


def test_split_of_every_place_is_the_same(places):
    splits = [
        [part.indices for part in pave.DataLoader(uri, seed=5).get_split()]
        for uri in places.values()
    ]
    assert splits[0] == splits[1] == splits[2]
    assert [len(part) for part in splits[0]] == [5, 1, 1]
