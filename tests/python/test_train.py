"""Training: a run that is killed and resumed is the run that was not, and what a run leaves behind.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import csv
import hashlib
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from training_data import make_sample, make_samples, one_thread  # noqa: F401

from pave import checkpoint, training_loop
from pave.dataset import RenderSettings, render_dataset
from pave.errors import InputError, RunError, UsageError
from pave.export import load_generator
from pave.options import TrainOptions
from pave.run_log import COLUMNS, read_history
from pave.samples import EncodedImages, epoch_order, mirror_batch
from pave.schema import fit_schema
from pave.train import TrainResult, train
from pave.trainer import Trainer

TINY = {
    "filters": 4,
    "unet_depth": 3,
    "d_filters": 4,
    "d_layers": 2,
    "epochs": 3,
    "batch": 2,
    "threads": 1,
    "deterministic": True,
    "norm": "batch",
    "checkpoint_seconds": 0.0,
}
SIZE = 16


def splits() -> tuple[list, list]:
    return make_samples(9, size=SIZE), make_samples(3, first=100, size=SIZE)


def run(folder: Path, **options: object) -> TrainResult:
    record = {**TINY, **options}
    on_progress = record.pop("on_progress", None)
    checked = TrainOptions.from_json(record)
    return train(splits(), folder, checked, on_progress=on_progress, figures=False)  # type: ignore[arg-type]


def weights_sha256(folder: Path) -> str:
    return hashlib.sha256((folder / "generator.safetensors").read_bytes()).hexdigest()


def test_run_folder(tmp_path: Path) -> None:
    records = []
    result = train(
        splits(),
        tmp_path,
        TrainOptions.from_json(TINY),
        provenance={"scene": "made up"},
        on_progress=records.append,
    )
    assert result.finished
    assert (result.epochs, result.steps, len(result.history)) == (3, 12, 3)
    with open(tmp_path / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert [float(row["epoch"]) for row in rows] == [1, 2, 3]
    assert all(value != "" for row in rows for value in row.values())
    assert (tmp_path / "loss.png").read_bytes().startswith(b"\x89PNG")
    assert list((tmp_path / "tensorboard").glob("events.out.tfevents.*"))
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["options"] == TrainOptions.from_json(TINY).to_json()
    assert config["provenance"]["scene"] == "made up"
    assert config["provenance"]["torch"] == torch.__version__
    assert len(checkpoint.list_checkpoints(tmp_path)) == checkpoint.KEPT
    loaded = load_generator(tmp_path)
    assert loaded.weights_version == result.weights_version
    assert loaded.training["best"]["epoch"] == result.best["epoch"]
    best = max(result.history, key=lambda row: row["val_psnr"])
    assert result.best["epoch"] == best["epoch"]
    last = records[-1]
    assert (last["step"], last["steps"], last["epoch"]) == (12, 12, 3)
    assert last["eta_seconds"] == 0
    assert not list(tmp_path.rglob(".*.tmp"))


def test_it_learns_and_beats_its_start(tmp_path: Path) -> None:
    result = run(tmp_path, epochs=25, lr=2e-3, norm="none")
    assert result.best["val_psnr"] > result.history[0]["val_psnr"] + 3
    assert result.history[-1]["g_l1"] < 0.6 * result.history[0]["g_l1"]


def test_validation_is_what_the_exported_generator_scores(tmp_path: Path) -> None:
    """The metrics of the best epoch come from the very weights that were exported, in eval mode."""
    from pave import metrics

    result = run(tmp_path)
    loaded = load_generator(tmp_path)
    _, validation = splits()
    scores = [float(metrics.psnr(loaded.draw(s), s["color"])) for s in validation]
    assert sum(scores) / len(scores) == pytest.approx(result.best["val_psnr"], abs=1e-3)
    scores = [float(metrics.ssim(loaded.draw(s), s["color"])) for s in validation]
    assert sum(scores) / len(scores) == pytest.approx(result.best["val_ssim"], abs=1e-4)


@pytest.mark.parametrize(("width", "height"), [(17, 13), (16, 11), (11, 40)])
def test_sizes_that_are_no_multiple_of_the_network(tmp_path: Path, width: int, height: int) -> None:
    """They train, and what was validated is what the exported generator draws of the whole image."""
    from pave import metrics

    data = [
        [make_sample(first + index, width, height) for index in range(count)]
        for first, count in ((0, 4), (100, 2))
    ]
    options = TrainOptions.from_json({**TINY, "mirror": True, "epochs": 2})
    result = train((data[0], data[1]), tmp_path, options, figures=False)
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["size"] == [width, height]
    loaded = load_generator(tmp_path)
    for name, function in (("val_psnr", metrics.psnr), ("val_ssim", metrics.ssim)):
        scores = [float(function(loaded.draw(s), s["color"])) for s in data[1]]
        assert sum(scores) / len(scores) == pytest.approx(result.best[name], abs=1e-3)


@pytest.mark.parametrize(("width", "height"), [(10, 64), (64, 10), (1, 1)])
def test_images_too_small_to_be_compared(tmp_path: Path, width: int, height: int) -> None:
    data = [make_sample(index, width, height) for index in range(2)]
    with pytest.raises(UsageError, match=f"{width}x{height} pixels are too small"):
        train((data, data), tmp_path / "run", TrainOptions.from_json(TINY), figures=False)
    assert not (tmp_path / "run").exists() or not any((tmp_path / "run").iterdir())


def test_discriminator_deeper_than_the_images(tmp_path: Path) -> None:
    data = [make_sample(index, 12) for index in range(2)]
    with pytest.raises(UsageError, match="4 is the most"):
        train((data, data), tmp_path, TrainOptions.from_json({**TINY, "d_layers": 5}))
    options = TrainOptions.from_json({**TINY, "d_layers": 4, "d_norm": "none", "epochs": 1})
    assert train((data, data), tmp_path, options, figures=False).finished


def test_same_seed_same_weights_and_another_seed_others(tmp_path: Path) -> None:
    hashes = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        run(tmp_path / name, seed=seed)
        hashes.append(weights_sha256(tmp_path / name))
    assert hashes[0] == hashes[1]
    assert hashes[0] != hashes[2]


@pytest.mark.parametrize("stop_at", [1, 3, 4, 7, 11])
def test_stopped_and_resumed_is_unbroken(tmp_path: Path, stop_at: int) -> None:
    """Stopped after any step, in mid-epoch, at its end, in the last one: the same weights and the same metrics."""
    whole = run(tmp_path / "whole", checkpoint_steps=1)

    class Stop(Exception):
        pass

    real_step = Trainer.step

    def step(self: Trainer, *batch: torch.Tensor) -> dict[str, torch.Tensor]:
        if self.step_index == stop_at:
            raise Stop
        return real_step(self, *batch)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trainer, "step", step)
        with pytest.raises(Stop):
            run(tmp_path / "broken", checkpoint_steps=1)
    assert not (tmp_path / "broken" / "generator.json").exists()
    resumed = run(tmp_path / "broken", checkpoint_steps=1)
    assert resumed.resumed_from == stop_at
    assert weights_sha256(tmp_path / "broken") == weights_sha256(tmp_path / "whole")
    for ours, theirs in zip(resumed.history, whole.history, strict=True):
        assert {**ours, "seconds": 0} == {**theirs, "seconds": 0}
    assert len(read_history(tmp_path / "broken")) == 3


KILLED = """
import sys
sys.path[:0] = sys.argv[2:]
from pathlib import Path
from test_train import run
print("ready", flush=True)
run(Path(sys.argv[1]), checkpoint_steps=3, epochs=20,
    on_progress=lambda record: print(record["step"], flush=True))
"""


def test_killed_in_mid_epoch_and_resumed_is_unbroken(tmp_path: Path) -> None:
    """kill -9 at steps nobody chose, twice; checkpoints every third step, so that some work is done anew."""
    run(tmp_path / "whole", epochs=20)
    folder = tmp_path / "killed"
    for wanted in (20, 50):
        process = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(folder), str(Path(__file__).parent), *sys.path],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stdout is not None
            deadline = time.monotonic() + 120
            for line in process.stdout:
                if line.strip().isdecimal() and int(line) >= wanted:
                    break
                assert time.monotonic() < deadline, "the run that is to be killed is stuck"
            process.send_signal(signal.SIGKILL)
        finally:
            process.kill()
            process.wait(timeout=60)
            process.stdout.close()
        assert process.returncode == -signal.SIGKILL, "it ended before it could be killed"
    result = run(folder, epochs=20)
    assert result.resumed_from >= 47
    assert weights_sha256(folder) == weights_sha256(tmp_path / "whole")


def test_finished_run_is_left_as_it_is(tmp_path: Path) -> None:
    run(tmp_path)
    before = weights_sha256(tmp_path)
    again = run(tmp_path)
    assert (again.resumed_from, again.steps) == (12, 12)
    assert again.finished
    assert weights_sha256(tmp_path) == before


def test_caller_can_stop_and_go_on(tmp_path: Path) -> None:
    stopped = run(tmp_path / "a", epochs=6, on_progress=lambda record: record["step"] < 10)
    assert not stopped.finished
    assert (stopped.steps, stopped.epochs) == (10, 2)
    assert run(tmp_path / "a", epochs=6).finished
    run(tmp_path / "b", epochs=6)
    assert weights_sha256(tmp_path / "a") == weights_sha256(tmp_path / "b")
    with pytest.raises(RunError, match="before the first epoch's end"):
        train(
            (make_samples(30, size=SIZE), make_samples(1, size=SIZE)),
            tmp_path / "c",
            TrainOptions.from_json(TINY),
            on_progress=lambda _: False,
            figures=False,
        )


def test_other_options_or_data_are_refused(tmp_path: Path) -> None:
    run(tmp_path)
    with pytest.raises(UsageError, match=r"lr 0\.\d+, not 0\.1"):
        run(tmp_path, lr=0.1)
    with pytest.raises(UsageError, match="other data"):
        train(
            (make_samples(9, first=50, size=SIZE), make_samples(3, size=SIZE)),
            tmp_path,
            TrainOptions.from_json(TINY),
            figures=False,
        )
    run(tmp_path, checkpoint_steps=5)  # how often it is saved changes nothing


def test_damaged_checkpoint_is_passed_over(tmp_path: Path) -> None:
    run(tmp_path, checkpoint_steps=2)
    before = weights_sha256(tmp_path)
    newest = checkpoint.list_checkpoints(tmp_path)[-1]
    data = bytearray(newest.read_bytes())
    data[len(data) // 2] ^= 1
    newest.write_bytes(data)
    result = run(tmp_path, checkpoint_steps=2)
    assert result.resumed_from == 10
    assert newest.name in result.remarks[0]
    assert weights_sha256(tmp_path) == before
    for path in checkpoint.list_checkpoints(tmp_path):
        path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="no whole checkpoint"):
        run(tmp_path)


def test_checkpoints_hold_no_code(tmp_path: Path) -> None:
    """A checkpoint with a pickled object in it is refused, and the object is not made."""
    import io
    import pickle

    import pave

    marker = tmp_path / "ran"

    class Payload:
        def __reduce__(self) -> tuple:
            return (Path.touch, (marker,))

    for blob in (pickle.dumps(Payload(), 2), _torch_saved({"trainer": Payload()}, io.BytesIO())):
        path = tmp_path / "step-0000000001.ckpt"
        path.write_bytes(b"PAVECKP1" + pave.hash_bytes(blob).encode() + blob)
        with pytest.raises(InputError):
            checkpoint.load_checkpoint(path)
        assert not marker.exists()


def _torch_saved(value: object, buffer: object) -> bytes:
    torch.save(value, buffer)  # type: ignore[arg-type]
    return buffer.getvalue()  # type: ignore[attr-defined]


def test_a_loss_that_is_no_number_stops_the_run(tmp_path: Path) -> None:
    real_step = Trainer.step

    def step(self: Trainer, *batch: torch.Tensor) -> dict[str, torch.Tensor]:
        losses = real_step(self, *batch)
        return losses if self.step_index < 7 else {**losses, "g_loss": torch.tensor(torch.nan)}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trainer, "step", step)
        with pytest.raises(RunError, match="after 7 steps"):
            run(tmp_path)
    assert checkpoint.list_checkpoints(tmp_path)[-1].name == "step-0000000004.ckpt"


def test_minutes_choose_epochs_once(tmp_path: Path) -> None:
    result = run(tmp_path, minutes=0.02, epochs=1)
    config = json.loads((tmp_path / "config.json").read_text())
    assert result.epochs <= config["epochs"]
    assert result.steps == 4 * result.epochs
    again = run(tmp_path, minutes=0.02, epochs=1)
    assert json.loads((tmp_path / "config.json").read_text()) == config
    assert again.epochs >= result.epochs


class Clock:
    """Stands in for the module `time` of the loop: a step takes as long as the test says, nothing else any time."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now


def test_minutes_that_are_up_end_the_run_for_good(tmp_path: Path) -> None:
    """Steps ten times slower than the trial said: the run ends in time, and a second call trains nothing more."""
    clock, real_step = Clock(), Trainer.step

    def step(self: Trainer, *batch: torch.Tensor) -> dict[str, torch.Tensor]:
        clock.now += 0.1 if self.steps == 1 else 1.0  # the trial's trainer is made for one step
        return real_step(self, *batch)

    minutes, epoch_seconds = 0.2, 4
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training_loop, "time", clock)
        patch.setattr(Trainer, "step", step)
        first = run(tmp_path, minutes=minutes)
        before = weights_sha256(tmp_path)
        config = json.loads((tmp_path / "config.json").read_text())
        again = run(tmp_path, minutes=minutes)
    # As many whole epochs as fit.
    assert first.epochs == int(60 * minutes * training_loop.HARD_LIMIT / epoch_seconds) == 3
    assert config["epochs"] == 3
    assert first.finished
    assert "minutes were up after 3 of the" in first.remarks[0]
    assert again.finished
    assert (again.steps, again.resumed_from, again.remarks) == (12, 12, [])
    assert weights_sha256(tmp_path) == before
    assert json.loads((tmp_path / "config.json").read_text()) == config


def test_minutes_leave_a_busy_machine_its_schedule(tmp_path: Path) -> None:
    """A fifth slower than the trial said is still within the hard limit: every planned epoch is trained."""
    clock, real_step = Clock(), Trainer.step

    def step(self: Trainer, *batch: torch.Tensor) -> dict[str, torch.Tensor]:
        clock.now += 0.1 if self.steps == 1 else 0.12
        return real_step(self, *batch)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training_loop, "time", clock)
        patch.setattr(Trainer, "step", step)
        result = run(tmp_path, minutes=0.1)
    assert result.remarks == []
    assert result.steps == 4 * json.loads((tmp_path / "config.json").read_text())["epochs"]
    assert result.history[-1]["lr"] < 0.05 * TrainOptions.lr


@pytest.mark.parametrize("stop_at", [2, 4, 5, 8])
def test_stop_in_a_step_or_in_validation_is_unbroken(tmp_path: Path, stop_at: int) -> None:
    """The first signal ends the step at hand, or the validation that follows it, and what resumes is the same run."""
    whole = run(tmp_path / "whole")
    real_step = Trainer.step

    def step(self: Trainer, *batch: torch.Tensor) -> dict[str, torch.Tensor]:
        losses = real_step(self, *batch)
        if self.step_index == stop_at:
            signal.raise_signal(signal.SIGTERM if stop_at % 2 else signal.SIGINT)
        return losses

    folder = tmp_path / "stopped"
    options = TrainOptions.from_json(TINY)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trainer, "step", step)
        try:
            if stop_at <= 4:
                with pytest.raises(RunError, match="before the first epoch's end"):
                    train(splits(), folder, options, figures=False, catch_signals=True)
                assert not (folder / "generator.json").exists()
            else:
                stopped = train(splits(), folder, options, figures=False, catch_signals=True)
                assert (stopped.finished, stopped.steps) == (False, stop_at)
                assert load_generator(folder).weights_version == stopped.weights_version
            for number in before:
                assert signal.getsignal(number) == signal.SIG_DFL, "a second one ends at once"
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
    assert checkpoint.list_checkpoints(folder)[-1].name == f"step-{stop_at:010d}.ckpt"
    resumed = run(folder)
    assert (resumed.resumed_from, resumed.steps) == (stop_at, whole.steps)
    assert weights_sha256(folder) == weights_sha256(tmp_path / "whole")
    for ours, theirs in zip(resumed.history, whole.history, strict=True):
        assert {**ours, "seconds": 0} == {**theirs, "seconds": 0}


def test_a_signal_too_late_to_stop_the_run_still_ends_the_command(tmp_path: Path) -> None:
    """While the last checkpoint is saved: the run is whole, but what would come after it is not begun."""
    from pave.console import Console
    from pave.training_session import run_training

    real = training_loop.save_checkpoint

    def save(folder: Path, state: dict, step: int) -> Path:
        if step == 12:
            signal.raise_signal(signal.SIGINT)
        return real(folder, state, step)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training_loop, "save_checkpoint", save)
        patch.setattr("pave.train.load_splits", lambda *_: (splits()[0], [], splits()[1]))
        try:
            with pytest.raises(RunError, match="interrupted after step 12"):
                run_training(Console(json_lines=True), "bp:made-up", tmp_path, dict(TINY))
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
    again = run(tmp_path)
    assert (again.resumed_from, again.finished) == (12, True)


def test_signals_are_what_they_were_after_a_run(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    train(splits(), tmp_path, TrainOptions.from_json(TINY), figures=False, catch_signals=True)
    assert signal.getsignal(signal.SIGINT) == before


@pytest.mark.parametrize("best", ["psnr", "ssim", "l1"])
def test_best_epoch_is_the_best_by_the_metric_chosen(tmp_path: Path, best: str) -> None:
    """Each metric has its best in another epoch; what is exported are that epoch's weights."""
    scores = {
        "val_psnr": [20.0, 30.0, 25.0, 24.0],
        "val_ssim": [0.5, 0.6, 0.9, 0.7],
        "val_l1": [0.2, 0.1, 0.3, 0.05],
    }
    chosen = {"psnr": 2, "ssim": 3, "l1": 4}[best]
    averages: list[dict[str, torch.Tensor]] = []

    def validate(self: training_loop.TrainingRun) -> dict[str, float]:
        weights = self.trainer.average.network.state_dict()
        averages.append({name: tensor.clone() for name, tensor in weights.items()})
        return {name: values[self.epoch] for name, values in scores.items()}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training_loop.TrainingRun, "_validate", validate)
        result = run(tmp_path, epochs=4, best=best)
    assert result.best["epoch"] == chosen
    exported = load_generator(tmp_path).weights
    for name, tensor in averages[chosen - 1].items():
        if name in exported:
            assert torch.equal(exported[name], tensor), name
    other = averages[chosen % 4]
    assert not all(torch.equal(exported[n], other[n]) for n in exported)


def test_training_reads_no_test_image(tmp_path: Path) -> None:
    """Of a data set by its URI only frames of the training and the validation split are ever opened."""
    import pave
    from pave.data import split_indices

    views = 10
    uri = f"bp:{tmp_path / 'd.bp'}"
    scene = pave.load_scene("cornell")
    render_dataset(
        pave.Device(),
        scene,
        uri,
        pave.hemisphere_views(scene, views, 0),
        RenderSettings(12, 12, 1, 3),
    )
    asked: set[int] = set()
    real = pave.Source.read

    def read(self: pave.Source, position: int) -> pave.Frame:
        asked.add(position)
        return real(self, position)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pave.Source, "read", read)
        options = TrainOptions.from_json({**TINY, "cache_bytes": 0})
        train(uri, tmp_path / "run", options, figures=False)
    training, test, validation = split_indices(views)
    assert asked == {*training, *validation}
    assert not asked & set(test)
    assert len(test) == 2


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("seed", -1),
        ("seed", 2**64),
        ("seed", 0.5),
        ("repeat_depth", 4),
        ("minutes", 0),
        ("threads", -1),
        ("checkpoint_seconds", -1),
        ("adversarial_weight", -1),
    ],
)
def test_options_are_bounded(name: str, value: float) -> None:
    with pytest.raises(UsageError, match=name):
        TrainOptions.from_json({name: value})
    assert TrainOptions.from_json({"seed": 2**64 - 1}).seed == 2**64 - 1


def test_order_depends_on_seed_and_epoch_alone() -> None:
    one = epoch_order(10, 4, seed=3, epoch=5)
    torch.rand(100)
    assert [b.tolist() for b in one] == [b.tolist() for b in epoch_order(10, 4, 3, 5)]
    assert [b.tolist() for b in one] != [b.tolist() for b in epoch_order(10, 4, 3, 6)]
    assert [b.tolist() for b in one] != [b.tolist() for b in epoch_order(10, 4, 4, 5)]
    assert [len(b) for b in one] == [4, 4]
    assert len({int(i) for b in one for i in b}) == 8
    assert [len(b) for b in epoch_order(3, 4, 0, 0)] == [3]


def test_images_in_memory_or_read_on_the_way_are_the_same() -> None:
    samples = make_samples(5, size=SIZE)
    schema = fit_schema(samples, ["albedo", "direct"])
    kept = EncodedImages(samples, schema, 1 << 30, "training")
    read = EncodedImages(samples, schema, 0, "training")
    assert kept.cache is not None
    assert read.cache is None
    order = epoch_order(5, 2, 0, 0)
    for a, b in zip(kept.batches(order), read.batches(order), strict=True):
        assert torch.equal(a[0], b[0])
        assert torch.equal(a[1], b[1])
        assert a[0].is_contiguous(memory_format=torch.channels_last)


def test_images_are_padded_as_the_generator_pads() -> None:
    samples = [make_sample(index, 13, 9) for index in range(3)]
    schema = fit_schema(samples, ["albedo", "direct"])
    images = EncodedImages(samples, schema, 1 << 30, "training", 8)
    assert (images.width, images.height) == (13, 9)
    for planes in images.batch(torch.tensor([0, 2])):
        assert planes.shape[-2:] == (16, 16)
        assert torch.equal(planes[..., 9:, :], planes[..., 8:9, :].expand(-1, -1, 7, -1))
        assert torch.equal(planes[..., 13:], planes[..., 12:13].expand(-1, -1, -1, 3))
    assert images.cache is not None
    per_image = 4 * (schema.in_planes + 3) * 16 * 16
    assert EncodedImages(samples, schema, 3 * per_image - 1, "training", 8).cache is None


def test_bad_images_are_named() -> None:
    samples = make_samples(3, size=SIZE)
    schema = fit_schema(samples, ["albedo", "direct"])
    with pytest.raises(UsageError, match="training split has no images"):
        EncodedImages([], schema, 0, "training")
    broken = [*samples[:2], {**samples[2], "direct": samples[2]["direct"] * torch.nan}]
    with pytest.raises(InputError, match="image 2 of the training split"):
        EncodedImages(broken, schema, 1 << 30, "training")
    broken = [*samples[:2], make_samples(1, size=SIZE * 2)[0]]
    with pytest.raises(InputError, match="image 2 of the training split is 32x32"):
        EncodedImages(broken, schema, 1 << 30, "training")


def test_mirrored_images_are_the_mirrored_world() -> None:
    samples = make_samples(2, size=SIZE)
    schema = fit_schema(samples, ["albedo", "normal", "position", "direct"])
    images = EncodedImages(samples, schema, 1 << 30, "training")
    buffers, target = images.batch(torch.tensor([0, 1]))
    same = mirror_batch(buffers, target, schema, 0)
    assert torch.equal(same[0], buffers)
    flipped, image = mirror_batch(buffers, target, schema, 1)
    assert torch.equal(image, target.flip(-1))
    assert torch.equal(flipped[:, :3], buffers[:, :3].flip(-1))
    assert torch.equal(flipped[:, 3], -buffers[:, 3].flip(-1)), "normal x"
    assert torch.equal(flipped[:, 4:6], buffers[:, 4:6].flip(-1)), "normal y, z"
    assert torch.equal(flipped[:, 6], -buffers[:, 6].flip(-1)), "position x"
    again = mirror_batch(*mirror_batch(buffers, target, schema, 1), schema, 1)
    assert torch.equal(again[0], buffers)


def test_gan_modes_norms_and_heads_all_train(tmp_path: Path) -> None:
    for index, options in enumerate(
        (
            {"gan_mode": "bce", "norm": "batch", "head": "sigmoid", "repeat_depth": 3},
            {"gan_mode": "lsgan", "norm": "instance"},
            {"gan_mode": "hinge", "norm": "none", "mirror": True},
            {"adversarial_weight": 0.0, "inputs": ["direct", "position"]},
        )
    ):
        result = run(tmp_path / str(index), epochs=1, **options)
        row = result.history[0]
        assert ("val_d_fake" in row) == ("adversarial_weight" not in options)
        assert 0 < row["g_l1"] < 1


def test_folder_that_cannot_be_written(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    with pytest.raises(RunError, match="cannot be made"):
        run(blocked / "run")


def test_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    for name, text in (("letter.txt", "dear"), ("config.json", '{"theme": "dark"}')):
        folder = tmp_path / name.partition(".")[0]
        folder.mkdir()
        (folder / name).write_text(text)
        with pytest.raises(UsageError, match="holds no training run"):
            run(folder)
        assert [path.name for path in folder.iterdir()] == [name]
        assert (folder / name).read_text() == text
    empty = tmp_path / "empty"
    empty.mkdir()
    assert run(empty).finished


def test_what_a_kill_left_half_written_is_removed(tmp_path: Path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait(timeout=60)
    stale = [tmp_path / f".config.json.{gone.pid}.tmp"]
    stale += [tmp_path / "checkpoints" / f".step-0000000004.ckpt.{gone.pid}.tmp"]
    run(tmp_path)
    for path in stale:
        path.write_text("x")
    run(tmp_path)
    assert not any(path.exists() for path in stale)


def test_cuda_is_refused_where_there_is_none(tmp_path: Path) -> None:
    if torch.cuda.is_available():
        assert run(tmp_path, device="cuda", deterministic=False).finished
    else:
        with pytest.raises(UsageError, match="no CUDA device"):
            run(tmp_path, device="cuda")
