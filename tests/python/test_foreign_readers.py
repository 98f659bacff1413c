"""What PAVE stores, read by programs that know nothing of PAVE: ADIOS2's own reader, OpenEXR's, and Mitsuba's.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import adios2
import mitsuba
import numpy as np
import OpenEXR
import pytest

import pave

CHANNELS = ["color", "albedo", "normal", "depth"]
LETTERS = {"albedo": "RGB", "normal": "XYZ", "depth": "Z"}
FRAMES = 5


def pixels(index: int, channel: str) -> np.ndarray:
    planes = 1 if channel == "depth" else 3
    random = np.random.default_rng([index, CHANNELS.index(channel)])
    values = random.normal(scale=100.0, size=(planes, 6, 9)).astype(np.float32)
    if channel == "depth":
        values[0, 0, 0] = np.inf
    return values


def write(uri: str, **options) -> None:
    with pave.Stage(
        None, uri, width=9, height=6, channels=CHANNELS, frames_per_shard=4, **options
    ) as stage:
        for index in range(FRAMES):
            frame = stage.acquire()
            for channel in CHANNELS:
                frame[channel].numpy()[:] = pixels(index, channel)
            frame.metadata.update(
                seed=2**64 - 1 - index, spp=64, rr_depth=5, scene=f"scene {index}"
            )
            stage.publish(frame)
            frame.release()


def test_adios2_reads_shards(tmp_path):
    write(f"bp:{tmp_path}/a.bp")
    index = 0
    for shard, steps in (("frames-00000000.bp", 4), ("frames-00000004-1.bp", 1)):
        with adios2.FileReader(f"{tmp_path}/a.bp/{shard}") as file:
            assert file.read_attribute("depth/unit") == "scene unit"
            assert int(file.available_variables()["color"]["AvailableStepsCount"]) == steps
            for step in range(steps):
                at = {"step_selection": [step, 1]}
                for channel in CHANNELS:
                    np.testing.assert_array_equal(file.read(channel, **at), pixels(index, channel))
                assert file.read("frame/index", **at) == index
                assert file.read("frame/rr_depth", **at) == 5
                assert file.read("frame/seed", **at) == [2**64 - 1 - index]
                assert file.read("frame/scene", **at) == f"scene {index}"
                index += 1
    assert index == FRAMES


@pytest.mark.parametrize(
    ("names", "color", "albedo", "normal", "depth"),
    [
        ("pave", "", "albedo.", "normal.", "depth."),
        ("oidn", "", "albedo.", "normal.", "Denoising Depth."),
        (
            "cycles",
            "ViewLayer.Combined.",
            "ViewLayer.Denoising Albedo.",
            "ViewLayer.Denoising Normal.",
            "ViewLayer.Depth.",
        ),
    ],
)
def test_openexr_reads_every_spelling(tmp_path, names, color, albedo, normal, depth):
    write(f"exr:{tmp_path}/a", exr_names=names)
    layers = {"color": color, "albedo": albedo, "normal": normal, "depth": depth}
    for index in range(FRAMES):
        with OpenEXR.File(f"{tmp_path}/a/frame-{index:08d}.exr", separate_channels=True) as file:
            stored = file.channels()
            for channel, layer in layers.items():
                for plane, letter in enumerate(LETTERS.get(channel, "RGB")):
                    np.testing.assert_array_equal(
                        stored[layer + letter].pixels, pixels(index, channel)[plane]
                    )
            header = file.header()
            assert header["pave.seed"] == str(2**64 - 1 - index)
            assert header["pave.spp"] == 64
            assert header["pave.rr_depth"] == 5
            assert header["compression"] == OpenEXR.ZIPS_COMPRESSION


def test_mitsuba_reads_exr(tmp_path):
    mitsuba.set_variant("scalar_rgb")
    write(f"exr:{tmp_path}/a")
    bitmap = mitsuba.Bitmap(f"{tmp_path}/a/frame-00000002.exr")
    stored = dict(bitmap.split())
    np.testing.assert_array_equal(
        np.asarray(stored["<root>"]).transpose(2, 0, 1), pixels(2, "color")
    )
    np.testing.assert_array_equal(
        np.asarray(stored["normal"]).transpose(2, 0, 1), pixels(2, "normal")
    )
