"""The two networks: shapes, what they are made of, and losses.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import math

import pytest
import torch
from torch import nn
from training_data import make_samples, one_thread  # noqa: F401

from pave import losses
from pave.errors import UsageError
from pave.models import Discriminator, Generator, GeneratorOptions
from pave.options import TrainOptions


def generator(in_planes: int = 10, **options: object) -> Generator:
    torch.manual_seed(5)
    return Generator(in_planes, GeneratorOptions(filters=4, **options), direct_first=3)  # type: ignore[arg-type]


@pytest.mark.parametrize("head", ["sigmoid", "residual"])
@pytest.mark.parametrize("depth", [1, 2, 4])
@pytest.mark.parametrize("norm", ["batch", "instance", "none"])
def test_any_multiple_gives_an_image_of_its_size(head: str, depth: int, norm: str) -> None:
    network = generator(unet_depth=depth, head=head, norm=norm).eval()
    assert network.multiple == 2**depth
    for height, width in ((2, 3), (4, 2)):
        buffers = torch.rand(2, 10, height * network.multiple, width * network.multiple)
        assert network(buffers).shape == (2, 3, *buffers.shape[-2:])


def test_residual_starts_near_the_direct_buffer() -> None:
    buffers = torch.rand(2, 10, 32, 32)
    with torch.no_grad():
        image = generator(unet_depth=3).eval()(buffers)
    assert float((image - buffers[:, 3:6]).abs().mean()) < 0.15


def test_every_layer_has_a_norm_of_its_own() -> None:
    network = generator(unet_depth=5, norm="batch")
    norms = [m for m in network.modules() if isinstance(m, nn.BatchNorm2d)]
    convolutions = [m for m in network.modules() if isinstance(m, (nn.Conv2d, nn.ConvTranspose2d))]
    assert len({id(m) for m in norms}) == len(norms) == 8
    # Each convolution has either a norm behind it or a bias of its own, never both and never neither.
    assert sum(m.bias is None for m in convolutions) == len(norms)


def test_skips_reach_the_output() -> None:
    """Every level of the encoder has gradients through its skip connection, and the input has every pixel's."""
    network = generator(unet_depth=4)
    buffers = torch.rand(1, 10, 32, 32, requires_grad=True)
    network(buffers)[0, :, 16, 16].sum().backward()
    for layer in network.encode:
        assert float(layer.conv.weight.grad.abs().max()) > 0
    assert int((buffers.grad.abs().sum(1) > 0).sum()) > 16 * 16


def test_a_single_pixel_inside_trains() -> None:
    """A U-Net as deep as the image is large has one value a plane inside, which has no variance to normalise."""
    network = generator(unet_depth=5, norm="batch").train()
    network(torch.rand(1, 10, 32, 32)).mean().backward()
    network = generator(unet_depth=5, norm="instance").train()
    network(torch.rand(1, 10, 32, 32)).mean().backward()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"filters": 0}, "filters 0"),
        ({"unet_depth": 11}, "unet_depth 11"),
        ({"norm": "group"}, "norm 'group'"),
        ({"head": "relu"}, "head 'relu'"),
        ({"refine": -1}, "refine -1"),
    ],
)
def test_bad_options_are_named(options: dict, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Generator(10, GeneratorOptions(**options), direct_first=3)


def test_residual_needs_the_direct_channel() -> None:
    with pytest.raises(UsageError, match="direct"):
        Generator(7, GeneratorOptions())
    with pytest.raises(UsageError, match="direct"):
        TrainOptions.from_json({"inputs": ["albedo", "depth"]})
    TrainOptions.from_json({"inputs": ["albedo", "depth"], "head": "sigmoid"})


def test_discriminator_judges_patches() -> None:
    torch.manual_seed(0)
    network = Discriminator(15, filters=4, layers=3, norm="batch")
    logits = network(torch.rand(2, 12, 64, 48), torch.rand(2, 3, 64, 48))
    assert logits.shape == (2, 1, 8, 6)
    with pytest.raises(UsageError, match="d_layers 7"):
        Discriminator(15, filters=4, layers=7, norm="batch")


def test_discriminator_learns_to_tell() -> None:
    """It must be able to: shown the path-traced image and the direct light alone, its verdicts part within three hundred steps."""
    from pave.schema import fit_schema

    samples = make_samples(8)
    schema = fit_schema(samples, ["albedo", "direct", "normal", "depth"])
    buffers = torch.stack([schema.encode_inputs(sample) for sample in samples])
    real = torch.stack([schema.encode_target(sample) for sample in samples])
    fake = buffers[:, 3:6]
    torch.manual_seed(2)
    options = TrainOptions()
    network = Discriminator(13, options.d_filters, options.d_layers, options.d_norm)
    betas = (options.beta1, options.beta2)
    adam = torch.optim.Adam(network.parameters(), lr=options.d_lr, betas=betas)
    real_loss, fake_loss = losses.discriminator_losses("bce")
    for _ in range(300):
        loss = real_loss(network(buffers, real)) + fake_loss(network(buffers, fake))
        adam.zero_grad()
        loss.backward()
        adam.step()
    verdicts = [float(network(buffers, image).detach().sigmoid().mean()) for image in (real, fake)]
    assert verdicts[0] - verdicts[1] > 0.4, verdicts


@pytest.mark.parametrize("mode", losses.GAN_MODES)
def test_losses_pull_the_right_way(mode: str) -> None:
    real_loss, fake_loss = losses.discriminator_losses(mode)
    g_loss = losses.generator_loss(mode)
    low, high = torch.full((4,), 0.2), torch.full((4,), 0.8)
    assert real_loss(high) < real_loss(low), "D must raise its verdict on real images"
    assert fake_loss(low) < fake_loss(high), "D must lower its verdict on generated images"
    assert g_loss(high) < g_loss(low), "G must raise D's verdict on its images"


def test_bce_is_the_papers_loss() -> None:
    """Binary cross entropy with labels 0.9 and 0.1, by hand."""
    real_loss, fake_loss = losses.discriminator_losses("bce")
    logit = 0.7
    p = 1 / (1 + math.exp(-logit))
    cross = -(0.9 * math.log(p) + 0.1 * math.log(1 - p))
    assert float(real_loss(torch.tensor([logit]))) == pytest.approx(cross, rel=1e-6)
    cross = -(0.1 * math.log(p) + 0.9 * math.log(1 - p))
    assert float(fake_loss(torch.tensor([logit]))) == pytest.approx(cross, rel=1e-6)


@pytest.mark.parametrize(("mode", "logit"), [("bce", 0.0), ("lsgan", 0.5), ("hinge", 0.0)])
def test_half_means_undecided(mode: str, logit: float) -> None:
    assert float(losses.probability(torch.full((3,), logit), mode)) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ({"epoch": 3}, "unknown training option 'epoch'"),
        ({"epochs": 0}, "epochs 0"),
        ({"lr": 0.0}, "lr"),
        ({"lr": float("nan")}, "lr nan"),
        ({"gan_mode": "wgan"}, "gan_mode 'wgan'"),
        ({"best": "lpips"}, "best 'lpips'"),
        ({"minutes": -1}, "minutes -1"),
        ({"l1_weight": 0.0, "adversarial_weight": 0.0}, "nothing to learn"),
        ({"inputs": ["albedo", "colour"]}, "'colour'"),
    ],
)
def test_bad_training_options_are_named(record: dict, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        TrainOptions.from_json(record)


def test_options_come_back_from_json() -> None:
    options = TrainOptions(filters=8, inputs=("direct",), minutes=3.5)
    assert TrainOptions.from_json(options.to_json()) == options
