"""A data set holds one scene rendered in one way: resuming it with anything else is refused, and nothing is changed.

SPDX-License-Identifier: BSD-3-Clause
"""

from dataclasses import replace
from pathlib import Path

import pytest

import pave
from pave.dataset import RenderSettings, render_dataset

SETTINGS = RenderSettings(width=12, height=8, spp=2, max_depth=3, seed=5, channels=["color"])
VIEWS = 4
MADE = 2  # frames of the unfinished set


class Stopped(Exception):
    """Ends a data set early, as an interruption does."""


@pytest.fixture(scope="module")
def device():
    return pave.Device()


@pytest.fixture(scope="module")
def scene():
    return pave.load_scene("cornell")


@pytest.fixture(params=["bp", "exr"])
def kind(request):
    return request.param


@pytest.fixture(params=["finished", "unfinished"])
def uri(request, kind, tmp_path, device, scene):
    """A data set of SETTINGS."""
    place = f"{kind}:{tmp_path / 'set'}"
    views = pave.hemisphere_views(scene, VIEWS, seed=1)
    if request.param == "finished":
        render_dataset(device, scene, place, views, SETTINGS)
        return place

    def stop(done, stage):
        if done == MADE:
            stage.flush()
            raise Stopped

    with pytest.raises(Stopped):
        render_dataset(device, scene, place, views, SETTINGS, frames_per_shard=1, on_frame=stop)
    return place


def manifest(uri):
    return (Path(uri.partition(":")[2]) / "manifest.jsonl").read_bytes()


def resume(device, scene, uri, settings=SETTINGS, view_seed=1):
    views = pave.hemisphere_views(scene, VIEWS, seed=view_seed)
    return render_dataset(device, scene, uri, views, settings, frames_per_shard=1, resume=True)


def refused(device, scene, uri, key, **changes):
    before = manifest(uri)
    with pytest.raises(pave.UsageError, match=f"was made with {key} "):
        resume(device, scene, uri, **changes)
    assert manifest(uri) == before


@pytest.mark.parametrize(
    ("key", "settings"),
    [
        ("spp", replace(SETTINGS, spp=3)),
        ("max_depth", replace(SETTINGS, max_depth=4)),
        ("seed", replace(SETTINGS, seed=6)),
        ("size", replace(SETTINGS, width=8)),
        ("channels", replace(SETTINGS, channels=["color", "depth"])),
    ],
)
def test_other_settings_are_refused(device, scene, uri, key, settings):
    refused(device, scene, uri, key, settings=settings)


def test_another_scene_is_refused(device, uri):
    refused(device, pave.load_scene("novel"), uri, "scene_hash")


def test_other_views_are_refused(device, scene, uri):
    refused(device, scene, uri, "view 0", view_seed=2)


@pytest.mark.parametrize(("stored", "same"), [(0, True), (3, False), (5, True)])
def test_roulette_is_compared_where_the_frames_tell_it(
    device, scene, uri, monkeypatch, stored, same
):
    real = pave.Source.metadata
    monkeypatch.setattr(
        pave.Source,
        "metadata",
        lambda self, position: {**real(self, position), "rr_depth": stored},
    )
    settings = replace(SETTINGS, rr_depth=5)
    if same:
        assert resume(device, scene, uri, settings)["acknowledged"] == VIEWS
    else:
        refused(device, scene, uri, "rr_depth", settings=settings)


def test_the_same_is_gone_on_with(device, scene, uri, request):
    counts = resume(device, scene, uri)
    made = VIEWS if "unfinished" not in request.node.name else MADE
    assert counts == {
        "frames": VIEWS, "resumed_from": made, "acknowledged": VIEWS, "warnings": []
    }  # fmt: skip
    assert pave.Source(uri).finished
