"""The command line: thin commands over the library, one edge where errors become a line and an exit code.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from pave import errors
from pave.bench.command import bench
from pave.console import Console
from pave.inference import DRAWING_SPP
from pave.options import TrainOptions as Defaults

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="PAVE couples a portable path tracer with machine learning, in place.",
)

Json = Annotated[bool, typer.Option("--json", help="One JSON object a line on stdout.")]
DeviceSpec = Annotated[
    str, typer.Option("--device", help="pocl, 0:1, cpu, gpu or a part of a name.")
]
Size = Annotated[
    str | None, typer.Option("--size", help="WIDTHxHEIGHT; default: the scene's film.")
]
Spp = Annotated[int | None, typer.Option("--spp", help="Samples a pixel; default: the scene's.")]
MaxDepth = Annotated[int | None, typer.Option("--max-depth", help="Edges of the longest path.")]
RrDepth = Annotated[
    int | None, typer.Option("--rr-depth", help="Russian roulette from this depth.")
]
Seed = Annotated[int, typer.Option("--seed", help="Key of the random numbers.")]
Define = Annotated[list[str] | None, typer.Option("-D", help="NAME=VALUE for a scene's <default>.")]
Ignore = Annotated[bool, typer.Option("--ignore-unsupported", help="Warn instead of failing.")]


def parse_size(text: str | None) -> tuple[int | None, int | None]:
    """'256x128' -> (256, 128); None -> (None, None). Raises UsageError."""
    if text is None:
        return None, None
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise errors.UsageError(f"--size {text}: write WIDTHxHEIGHT, for example 256x256")
    return int(width), int(height)


def parse_defines(items: list[str] | None) -> dict[str, str]:
    """['a=1'] -> {'a': '1'}. Raises UsageError."""
    defines = {}
    for item in items or []:
        name, equals, value = item.partition("=")
        if not equals or not name:
            raise errors.UsageError(f"-D {item}: write NAME=VALUE")
        defines[name] = value
    return defines


def parse_channels(text: str) -> list[str]:
    """'color,depth' -> ['color', 'depth']."""
    return [name.strip() for name in text.split(",") if name.strip()]


def _load_scene(console: Console, name: str, defines: list[str] | None, ignore: bool) -> Any:
    import pave

    scene = pave.load_scene(name, ignore_unsupported=ignore, defines=parse_defines(defines))
    console.warn(scene.warnings)
    return scene


@app.command()
def doctor(device: DeviceSpec = "", json: Json = False) -> None:
    """Check the installation and say how to mend what is missing."""
    from pave.doctor import run_checks

    console = Console(json)
    records = run_checks(device)
    for record in records:
        mark = "ok  " if record["ok"] else "FAIL"
        fix = f"  -> {record['fix']}" if record.get("fix") else ""
        console.result(record, f"{mark} {record['check']}: {record['detail']}{fix}")
    broken = [record for record in records if not record["ok"]]
    if any(record["check"] == "opencl" for record in broken):
        raise typer.Exit(int(errors.ExitCode.DEVICE))
    if broken:
        raise typer.Exit(int(errors.ExitCode.RUN))


@app.command()
def devices(json: Json = False) -> None:
    """List the OpenCL devices."""
    import pave

    console = Console(json)
    for profile in pave.devices():
        record = profile.to_dict()
        console.result(
            record,
            f"{profile.id}  {profile.name}  [{profile.platform}, {profile.driver}]  "
            f"{profile.compute_units} units, {profile.lane_width} lanes",
        )


@app.command()
def render(
    scene: Annotated[str, typer.Argument(help="Scene file or a name such as 'cornell'.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="x.exr (all channels) or x.png.")],
    size: Size = None,
    spp: Spp = None,
    max_depth: MaxDepth = None,
    rr_depth: RrDepth = None,
    seed: Seed = 0,
    device: DeviceSpec = "",
    channels: Annotated[
        str, typer.Option(help="Comma-separated channel names.")
    ] = "color,albedo,direct,normal,depth,variance",
    names: Annotated[str, typer.Option(help="EXR channel spelling: pave, oidn, cycles.")] = "pave",
    define: Define = None,
    ignore_unsupported: Ignore = False,
    json: Json = False,
) -> None:
    """Render one view of a scene, all its buffers in one pass."""
    import pave
    from pave.dataset import RenderSettings, left_out
    from pave.image import check_output, write_image

    console = Console(json)
    check_output(output, names, parse_channels(channels))
    loaded = _load_scene(console, scene, define, ignore_unsupported)
    width, height = parse_size(size)
    settings = RenderSettings(
        width, height, spp, max_depth, rr_depth, seed, parse_channels(channels)
    ).resolved(loaded)
    target = pave.Device(device)
    stage = pave.Stage(
        target,
        "mem:",
        width=settings.width,
        height=settings.height,
        channels=settings.channels,
        slots=1,
    )
    frame = stage.acquire()
    renderer = pave.Renderer(target, loaded)
    with console.progress("render", 100, "%") as bar:

        def report(done: float) -> bool:
            bar.update(100 * done)
            return True

        renderer.render(
            loaded.view,
            frame,
            spp=settings.spp,
            max_depth=settings.max_depth,
            rr_depth=settings.rr_depth,
            seed=settings.seed,
            progress=report,
        )
    write_image(frame, output, names)
    console.warn(left_out(renderer))
    seconds = frame.metadata["seconds_spent"]
    paths = settings.width * settings.height * settings.spp
    console.result(
        {
            "output": str(output),
            "scene": loaded.name,
            "size": [settings.width, settings.height],
            "spp": settings.spp,
            "max_depth": settings.max_depth,
            "seed": settings.seed,
            "device": target.profile.name,
            "seconds": seconds,
            "paths_per_second": paths / seconds if seconds else 0.0,
        },
        f"{output}: {settings.width}x{settings.height}, {settings.spp} samples, {seconds:.2f} s, "
        f"{paths / max(seconds, 1e-9) / 1e6:.1f} million paths/s",
    )


@app.command()
def dataset(
    scene: Annotated[str, typer.Argument(help="Scene file or name.")],
    uri: Annotated[str, typer.Argument(help="bp:PATH or exr:DIR.")],
    views: Annotated[int, typer.Option(help="Views on the hemisphere.")] = 480,
    views_file: Annotated[Path | None, typer.Option(help="JSON list of views instead.")] = None,
    size: Size = None,
    spp: Spp = None,
    max_depth: MaxDepth = None,
    rr_depth: RrDepth = None,
    seed: Seed = 0,
    device: DeviceSpec = "",
    channels: Annotated[
        str, typer.Option(help="Comma-separated channel names.")
    ] = "color,albedo,direct,normal,depth,variance",
    slots: Annotated[int, typer.Option(help="Frames in flight.")] = 8,
    frames_per_shard: Annotated[
        int, typer.Option(help="Frames that become durable together.")
    ] = 16,
    names: Annotated[str, typer.Option(help="EXR channel spelling: pave, oidn, cycles.")] = "pave",
    resume: Annotated[bool, typer.Option("--resume", help="Go on after the last frame.")] = False,
    trace: Annotated[Path | None, typer.Option(help="Chrome trace of what overlapped.")] = None,
    define: Define = None,
    ignore_unsupported: Ignore = False,
    json: Json = False,
) -> None:
    """Render a data set: every view with all its buffers, saved while the next one renders."""
    import pave
    from pave.dataset import RenderSettings, read_views, render_dataset

    console = Console(json)
    if not uri.startswith(("bp:", "exr:")):
        raise errors.UsageError(f"'{uri}': a data set goes to bp:PATH or exr:DIR")
    if views_file is None and not 1 <= views <= 10_000_000:
        raise errors.UsageError(f"--views {views} is outside 1..10000000")
    loaded = _load_scene(console, scene, define, ignore_unsupported)
    width, height = parse_size(size)
    settings = RenderSettings(
        width, height, spp, max_depth, rr_depth, seed, parse_channels(channels)
    ).resolved(loaded)
    view_list = read_views(views_file) if views_file else pave.hemisphere_views(loaded, views, seed)
    recorder = pave.Trace() if trace else None
    with console.progress("dataset", len(view_list), "frames") as bar:

        def on_frame(done: int, stage: pave.Stage) -> None:
            bar.update(done)
            console.event({"rendered": done, "acknowledged": stage.acknowledged})

        try:
            counts = render_dataset(
                pave.Device(device),
                loaded,
                uri,
                view_list,
                settings,
                slots=slots,
                frames_per_shard=frames_per_shard,
                exr_names=names,
                resume=resume,
                trace=recorder,
                on_frame=on_frame,
            )
        finally:
            if recorder is not None:
                recorder.write(str(trace))
    console.warn(counts["warnings"])
    console.result({"uri": uri, **counts}, f"{uri}: {counts['acknowledged']} frames")


@app.command()
def info(
    what: Annotated[str, typer.Argument(help="A data set's URI or a run folder.")],
    json: Json = False,
) -> None:
    """Verify a data set or a run and show what it holds."""
    from pave.inspection import describe

    Console(json).result(describe(what))


@app.command()
def train(
    uri: Annotated[str, typer.Argument(help="Data set: bp:PATH, exr:DIR.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Run folder: a new one, or one to go on with.")
    ],
    inputs: Annotated[str, typer.Option(help="Input channels.")] = ",".join(Defaults.inputs),
    repeat_depth: Annotated[
        int, typer.Option(help="Planes that depth is given as; 3 in the papers.")
    ] = Defaults.repeat_depth,
    epochs: Annotated[int, typer.Option(help="Passes over the training split.")] = Defaults.epochs,
    minutes: Annotated[
        float | None,
        typer.Option(help="Instead of --epochs: as many as fit, by a short trial. Default: none."),
    ] = Defaults.minutes,
    batch: Annotated[int, typer.Option(help="Images a step.")] = Defaults.batch,
    lr: Annotated[float, typer.Option(help="Adam's learning rate.")] = Defaults.lr,
    d_lr: Annotated[float, typer.Option(help="The discriminator's.")] = Defaults.d_lr,
    beta1: Annotated[float, typer.Option(help="Adam's first beta.")] = Defaults.beta1,
    beta2: Annotated[float, typer.Option(help="Adam's second beta.")] = Defaults.beta2,
    l1_weight: Annotated[float, typer.Option(help="Weight of the L1 loss.")] = Defaults.l1_weight,
    adversarial_weight: Annotated[
        float, typer.Option(help="Weight of the adversarial loss; 0 trains no discriminator.")
    ] = Defaults.adversarial_weight,
    gan_mode: Annotated[
        str, typer.Option(help="Adversarial loss: bce, lsgan or hinge.")
    ] = Defaults.gan_mode,
    filters: Annotated[int, typer.Option(help="Filters of the first layer.")] = Defaults.filters,
    unet_depth: Annotated[int, typer.Option(help="Levels of the U-Net.")] = Defaults.unet_depth,
    norm: Annotated[str, typer.Option(help="batch, instance or none.")] = Defaults.norm,
    head: Annotated[str, typer.Option(help="Output: residual or sigmoid.")] = Defaults.head,
    mirror: Annotated[
        bool, typer.Option("--mirror", help="Every second step sees the mirrored world.")
    ] = Defaults.mirror,
    best: Annotated[
        str, typer.Option(help="What chooses the best epoch: psnr, ssim or l1.")
    ] = Defaults.best,
    seed: Seed = Defaults.seed,
    deterministic: Annotated[
        bool, typer.Option("--deterministic", help="Same bits.")
    ] = Defaults.deterministic,
    checkpoint_seconds: Annotated[
        float, typer.Option(help="Save in mid-epoch after this time; 0: never.")
    ] = Defaults.checkpoint_seconds,
    threads: Annotated[int, typer.Option(help="0: torch's own choice.")] = Defaults.threads,
    torch_device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = Defaults.device,
    json: Json = False,
) -> None:
    """Train the conditional GAN on a data set; resumes by itself if the run folder has a checkpoint."""
    from pave.training_session import run_training

    console = Console(json)
    options = {
        "inputs": parse_channels(inputs),
        "repeat_depth": repeat_depth,
        "epochs": epochs,
        "minutes": minutes,
        "batch": batch,
        "lr": lr,
        "d_lr": d_lr,
        "beta1": beta1,
        "beta2": beta2,
        "l1_weight": l1_weight,
        "adversarial_weight": adversarial_weight,
        "gan_mode": gan_mode,
        "filters": filters,
        "unet_depth": unet_depth,
        "norm": norm,
        "head": head,
        "mirror": mirror,
        "best": best,
        "seed": seed,
        "deterministic": deterministic,
        "checkpoint_seconds": checkpoint_seconds,
        "threads": threads,
        "device": torch_device,
    }
    result = run_training(console, uri, output, options)
    console.result(result)


@app.command()
def evaluate(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    uri: Annotated[str, typer.Argument(help="The data set it was trained on.")],
    novel: Annotated[str | None, typer.Option(help="A data set of another scene.")] = None,
    json: Json = False,
) -> None:
    """Measure a trained generator on every split, against the baselines."""
    from pave.training_session import run_evaluation

    console = Console(json)
    console.result(run_evaluation(console, run, uri, novel))


@app.command()
def infer(
    run: Annotated[Path, typer.Argument(help="Run folder with the generator.")],
    scene: Annotated[str, typer.Argument(help="Scene file or name.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="x.exr or x.png.")],
    size: Size = None,
    spp: Annotated[int, typer.Option(help="Samples of the cheap buffers.")] = DRAWING_SPP,
    seed: Seed = 0,
    device: DeviceSpec = "",
    compare: Annotated[
        bool, typer.Option("--compare", help="Path trace the view as well and print PSNR and SSIM.")
    ] = False,
    define: Define = None,
    ignore_unsupported: Ignore = False,
    json: Json = False,
) -> None:
    """Render only the cheap buffers of a scene and let the network draw the rest, in the renderer."""
    from pave.dataset import RenderSettings
    from pave.image import check_output, write_image
    from pave.inference import draw_view

    console = Console(json)
    check_output(output)
    loaded = _load_scene(console, scene, define, ignore_unsupported)
    settings = RenderSettings(*parse_size(size), spp, seed=seed).resolved(loaded)
    frame, record = draw_view(
        run,
        loaded,
        device=device,
        width=settings.width,
        height=settings.height,
        spp=settings.spp,
        seed=settings.seed,
        compare=compare,
    )
    write_image(frame, output, "pave", color="drawn")
    console.result({"output": str(output), **record})


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(help="Where everything goes.")] = Path("demo-out"),
    quick: Annotated[bool, typer.Option("--quick", help="Under three minutes, small.")] = False,
    full: Annotated[
        bool, typer.Option("--full", help="The papers' setting, for large machines.")
    ] = False,
    device: DeviceSpec = "",
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """The papers' experiment: render a data set, train on it, evaluate, draw in the renderer, report."""
    from pave.demo import run_demo

    if quick and full:
        raise errors.UsageError("--quick and --full exclude each other")
    console = Console(json)
    setting = "quick" if quick else "full" if full else "standard"
    record = run_demo(console, folder, setting, device=device, seed=seed)
    console.result(record)


app.command()(bench)


INTERRUPTED = 130  # what typer makes of KeyboardInterrupt, which is not one of PAVE's exit codes


def _stop(number: int, _frame: Any) -> None:
    signal.signal(number, signal.SIG_DFL)  # a second one ends the process at once
    raise KeyboardInterrupt(signal.Signals(number).name)


def main() -> None:
    """Runs the command line and exits with the codes of docs/errors.md."""
    debug = os.environ.get("PAVE_DEBUG") == "1"
    signal.signal(signal.SIGTERM, _stop)
    signal.signal(signal.SIGINT, _stop)
    try:
        code = app(standalone_mode=False, prog_name="pave")
        if code == INTERRUPTED:
            raise KeyboardInterrupt
        sys.exit(code if isinstance(code, int) else int(errors.ExitCode.DONE))
    except errors.Error as error:
        if debug:
            raise
        _fail(str(error), error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted; what was acknowledged is kept", errors.ExitCode.RUN)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(int(errors.ExitCode.RUN))
    except OSError as error:
        if debug:
            raise
        _fail(f"{error.filename or 'I/O'}: {error.strerror or error}", errors.ExitCode.RUN)
    except MemoryError:
        _fail("out of memory: choose a smaller --size or fewer --slots", errors.ExitCode.RUN)
    except Exception as error:
        if hasattr(error, "format_message"):  # the parser's own errors: unknown option, bad number
            if type(error).__name__ == "NoArgsIsHelpError":
                error.show()
                sys.exit(int(errors.ExitCode.USAGE))
            _fail(error.format_message(), errors.ExitCode.USAGE)
        if debug:
            raise
        _fail(
            f"internal error, please report: {type(error).__name__}: {error} "
            "(PAVE_DEBUG=1 shows where)",
            errors.ExitCode.RUN,
        )


def _fail(message: str, code: int) -> None:
    """One line on stderr, then the exit code."""
    print(f"pave: error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(int(code))
