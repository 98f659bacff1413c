"""Renders a list of views into a stage: the next frame is rendered while the last one is saved.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pave.errors import InputError, UsageError

if TYPE_CHECKING:
    import pave

CHANNELS = ("color", "albedo", "direct", "normal", "depth", "variance")
CHEAP_CHANNELS = ("albedo", "direct", "normal", "depth")


@dataclass
class RenderSettings:
    """How every view is rendered; None takes the scene file's own value.

    `seed` keys the random numbers together with the frame's number, so that a frame has the same bits however the data
    set was made, in one go or resumed.
    """

    width: int | None = None
    height: int | None = None
    spp: int | None = None
    max_depth: int | None = None
    rr_depth: int | None = None
    seed: int = 0
    channels: Sequence[str] = field(default_factory=lambda: list(CHANNELS))

    def resolved(self, scene: pave.Scene) -> RenderSettings:
        """The same settings with the scene's values where none was given."""

        def either(value: int | None, default: int) -> int:
            return default if value is None else value

        settings = RenderSettings(
            width=either(self.width, scene.width),
            height=either(self.height, scene.height),
            spp=either(self.spp, scene.spp),
            max_depth=either(self.max_depth, scene.max_depth),
            rr_depth=either(self.rr_depth, scene.rr_depth),
            seed=self.seed,
            channels=list(self.channels),
        )
        settings.check()
        return settings

    def check(self) -> None:
        """Raises UsageError for what the renderer would refuse, before kernels are compiled for nothing."""
        for name, value, low, high in (
            ("spp", self.spp, 1, 2**24),
            ("max_depth", self.max_depth, 1, 2**31 - 1),
            ("rr_depth", self.rr_depth, 0, 2**31 - 1),
            ("seed", self.seed, 0, 2**64 - 1),
        ):
            if value is not None and not low <= value <= high:
                raise UsageError(f"{name} {value} is outside {low}..{high}")


def read_views(path: str | Path) -> list[pave.View]:
    """Views from a JSON list of {"eye": [x,y,z], "target": [x,y,z], "up": [x,y,z], "fov": degrees}.

    `up` defaults to +Y and `fov` to 40. Raises InputError naming the file and the view.
    """
    import pave

    path = Path(path)
    try:
        records = json.loads(path.read_text())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: not JSON: {error}") from error
    if not isinstance(records, list) or not records:
        raise InputError(f"{path}: a views file is a list with at least one view")
    views = []
    for number, record in enumerate(records):
        try:
            unknown = set(record) - {"eye", "target", "up", "fov"}
            if unknown:
                raise ValueError(f"unknown key '{min(unknown)}'")
            views.append(
                pave.look_at(
                    [float(x) for x in record["eye"]],
                    [float(x) for x in record["target"]],
                    up=[float(x) for x in record.get("up", (0.0, 1.0, 0.0))],
                    fov=float(record.get("fov", 40.0)),
                )
            )
        except KeyError as error:
            raise InputError(f"{path}: view {number}: missing key {error}") from error
        except (TypeError, ValueError, UsageError) as error:
            raise InputError(f"{path}: view {number}: {error}") from error
    return views


def render_views(
    renderer: pave.Renderer,
    stage: pave.Stage,
    views: Sequence[pave.View],
    settings: RenderSettings,
    *,
    on_frame: Callable[[int, pave.Stage], None] | None = None,
    trace: pave.Trace | None = None,
) -> None:
    """Renders `views[stage.first_index:]` into `stage`, which stays open.

    `on_frame(done, stage)` is called after each frame with the number of frames rendered so far. Raises what the
    renderer or the stage raises.
    """
    settings = settings.resolved(renderer.scene)
    for index in range(stage.first_index, len(views)):
        frame = stage.acquire()
        with trace.span("render", f"frame {index}") if trace is not None else nullcontext():
            renderer.render(
                views[index],
                frame,
                spp=settings.spp,
                max_depth=settings.max_depth,
                rr_depth=settings.rr_depth,
                seed=settings.seed,
                frame_index=index,
            )
        stage.publish(frame)
        del frame
        if on_frame is not None:
            on_frame(index + 1, stage)


def check_resume(
    uri: str, scene: pave.Scene, views: Sequence[pave.View], settings: RenderSettings
) -> int | None:
    """Frames of a data set that its writer closed; None if it is unfinished or not there.

    `settings` are resolved ones. Raises UsageError that names the first thing in which the frames there differ from what is
    asked for now: one data set holds one scene, rendered in one way.
    """
    import pave

    if not Path(uri.partition(":")[2]).exists():
        return None
    try:
        source = pave.Source(uri, allow_unfinished=True)
    except InputError:
        return None  # the stage says what is wrong with it
    there: dict[str, Any] = {"size": (source.width, source.height), "channels": source.channels}
    asked: dict[str, Any] = {
        "size": (settings.width, settings.height),
        "channels": list(settings.channels),
    }
    if len(source) and views:
        first = source.metadata(0)
        there["scene_hash"], asked["scene_hash"] = first["scene_hash"], scene.hash
        for key in ("spp", "max_depth", "seed"):
            there[key], asked[key] = first[key], getattr(settings, key)
        if first.get("rr_depth"):  # 0 or absent: its writer did not say
            there["rr_depth"], asked["rr_depth"] = first["rr_depth"], settings.rr_depth
        there["view 0"] = _view_of(first)
        asked["view 0"] = views[0]
    for key, value in asked.items():
        if there[key] != value:
            raise UsageError(
                f"{uri} was made with {key} {there[key]}, not {value}; "
                "ask for the same to resume it, or name another place"
            )
    return len(source) if source.finished else None


def _view_of(metadata: pave.Metadata) -> pave.View:
    import numpy as np

    import pave

    matrix = np.array(metadata["world_from_camera"], dtype=np.float32).reshape(4, 4)
    return pave.View(matrix, metadata["fov_x_degrees"])


def left_out(renderer: pave.Renderer) -> list[str]:
    """What a renderer had to leave out so far, a line each; empty if nothing."""
    lines = []
    if renderer.dropped_triangles:
        lines.append(f"triangles without area, left out: {renderer.dropped_triangles}")
    if renderer.dropped_samples:
        lines.append(f"samples that were not finite, counted as black: {renderer.dropped_samples}")
    return lines


def render_dataset(
    device: pave.Device,
    scene: pave.Scene,
    uri: str,
    views: Sequence[pave.View],
    settings: RenderSettings,
    *,
    slots: int = 8,
    frames_per_shard: int = 16,
    exr_names: str = "pave",
    resume: bool = False,
    trace: pave.Trace | None = None,
    on_frame: Callable[[int, pave.Stage], None] | None = None,
) -> dict[str, Any]:
    """One call from scene to data set. Returns counts (frames, resumed_from, acknowledged) and `warnings`.

    With `resume` an unfinished data set is gone on with and a finished one of as many frames is left as it is. If
    anything is raised, frames acknowledged until then stay readable and the data set stays open for `resume`.
    """
    import pave

    settings = settings.resolved(scene)
    there = check_resume(uri, scene, views, settings) if resume else None
    if there is not None:
        if there != len(views):
            raise UsageError(
                f"{uri} is finished with {there} frames, not the {len(views)} asked for"
            )
        return {"frames": there, "resumed_from": there, "acknowledged": there, "warnings": []}
    renderer = pave.Renderer(device, scene)
    with pave.Stage(
        device,
        uri,
        width=settings.width,
        height=settings.height,
        channels=list(settings.channels),
        slots=slots,
        frames_per_shard=frames_per_shard,
        exr_names=exr_names,
        resume=resume,
        trace=trace,
    ) as stage:
        first = stage.first_index
        if first > len(views):
            raise UsageError(f"{uri} has {first} frames, more than the {len(views)} asked for")
        render_views(renderer, stage, views, settings, on_frame=on_frame, trace=trace)
    return {
        "frames": len(views),
        "resumed_from": first,
        "acknowledged": stage.acknowledged,
        "warnings": left_out(renderer),
    }
