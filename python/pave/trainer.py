"""One training step of the conditional GAN, and everything that it changes, as one state that can be saved.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import copy
import math
from typing import Any

import torch
from torch import nn

from pave.losses import discriminator_losses, generator_loss, probability
from pave.models import Discriminator, Generator
from pave.options import TrainOptions
from pave.schema import Schema
from pave.transfer import compressed_peak


def make_generator(schema: Schema, options: TrainOptions) -> Generator:
    """The generator that `options` describe, for the inputs of `schema`."""
    return Generator(
        schema.in_planes,
        options.generator,
        out_planes=schema.output_planes,
        direct_first=schema.first_plane("direct"),
    )


class Average:
    """Exponential moving average of a network: steadier, and 0.5 to 1 dB better, than the last step's weights."""

    def __init__(self, network: nn.Module, decay: float) -> None:
        self.network = copy.deepcopy(network).requires_grad_(False).eval()
        self.decay = decay
        self.updates = 0

    @torch.no_grad()
    def update(self, network: nn.Module) -> None:
        """Takes one step's weights in. The decay rises with the number of steps, so that the start is forgotten."""
        self.updates += 1
        weight = 1 - min(self.decay, (1 + self.updates) / (10 + self.updates))
        mine, theirs = self.network.state_dict(), network.state_dict()
        floats = [name for name, value in mine.items() if value.is_floating_point()]
        torch._foreach_lerp_([mine[n] for n in floats], [theirs[n] for n in floats], weight)
        for name, value in mine.items():
            if not value.is_floating_point():
                value.copy_(theirs[name])


class GradientLimit:
    """Scales a gradient down to at most three times the usual length.

    Adam's steps follow the gradients of the last thousand steps: one that is much longer than those throws a network
    without normalisation so far off that it does not come back (measured: at step 130, lr 2e-3, batch 2).
    """

    FACTOR = 3.0
    MEMORY = 0.98
    WARM_UP = 20  # steps in which gradients shrink by themselves

    def __init__(self, network: nn.Module) -> None:
        self.parameters = list(network.parameters())
        self.usual = 0.0
        self.seen = 0

    def apply(self) -> None:
        """Limits the gradients that are there; to be called between backward() and the optimiser's step."""
        limit = self.FACTOR * self.usual if self.seen >= self.WARM_UP else math.inf
        norm = float(nn.utils.clip_grad_norm_(self.parameters, limit))
        norm = min(norm, limit)
        self.usual = (
            norm if self.seen == 0 else self.usual + (1 - self.MEMORY) * (norm - self.usual)
        )
        self.seen += 1


class Trainer:
    """Two networks, two optimisers and the average, on one device. `steps` is the length of the whole run.

    The learning rate rises over the first 2 % of the steps and falls as half a cosine to a hundredth.
    """

    def __init__(self, schema: Schema, options: TrainOptions, steps: int, device: torch.device):
        self.options, self.steps, self.device = options, max(steps, 1), device
        self.display_scale = compressed_peak(schema.peak)
        torch.manual_seed(options.seed)
        self.generator = self._place(make_generator(schema, options))
        self.discriminator = self._place(
            Discriminator(
                schema.in_planes + schema.output_planes,
                options.d_filters,
                options.d_layers,
                options.d_norm,
            )
        )
        self.average = Average(self.generator, options.ema_decay)
        betas = (options.beta1, options.beta2)
        self.g_adam = torch.optim.Adam(self.generator.parameters(), lr=options.lr, betas=betas)
        self.d_adam = torch.optim.Adam(
            self.discriminator.parameters(), lr=options.d_lr, betas=betas
        )
        self.real_loss, self.fake_loss = discriminator_losses(options.gan_mode)
        self.g_loss = generator_loss(options.gan_mode)
        self.g_limit, self.d_limit = (
            GradientLimit(self.generator),
            GradientLimit(self.discriminator),
        )
        self.step_index = 0

    def _place(self, network: nn.Module) -> Any:
        # Channels last is what the convolutions of oneDNN and cuDNN work in: no reordering between layers.
        return network.to(self.device, memory_format=torch.channels_last)

    def _set_rate(self) -> None:
        warm_up = max(1, round(0.02 * self.steps))
        done = self.step_index / self.steps
        factor = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(done, 1.0)))
        factor *= min(1.0, (self.step_index + 1) / warm_up)
        for adam, rate in ((self.g_adam, self.options.lr), (self.d_adam, self.options.d_lr)):
            for group in adam.param_groups:
                group["lr"] = rate * factor

    @property
    def rate(self) -> float:
        """The generator's learning rate in the last step."""
        return float(self.g_adam.param_groups[0]["lr"])

    def step(self, buffers: torch.Tensor, target: torch.Tensor) -> dict[str, torch.Tensor]:
        """One step of D, then one of G, on a batch of encoded buffers and images. Returns losses, not yet on the host."""
        self._set_rate()
        generator, discriminator, options = self.generator, self.discriminator, self.options
        generator.train()
        discriminator.train()
        fake = generator(buffers)

        losses: dict[str, torch.Tensor] = {}
        if options.adversarial_weight > 0:
            discriminator.requires_grad_(True)
            real_logits = discriminator(buffers, target)
            fake_logits = discriminator(buffers, fake.detach())
            d_loss = 0.5 * (self.real_loss(real_logits) + self.fake_loss(fake_logits))
            self.d_adam.zero_grad(set_to_none=True)
            d_loss.backward()
            self.d_limit.apply()
            self.d_adam.step()
            losses["d_loss"] = d_loss.detach()
            losses["d_real"] = probability(real_logits.detach(), options.gan_mode)
            losses["d_fake"] = probability(fake_logits.detach(), options.gan_mode)

        # In units of sRGB, whatever the brightest light of the scene is.
        l1 = (fake - target).abs().mean() * self.display_scale
        total = options.l1_weight * l1
        if options.adversarial_weight > 0:
            discriminator.requires_grad_(False)
            adversarial = self.g_loss(discriminator(buffers, fake))
            total = total + options.adversarial_weight * adversarial
            losses["g_adversarial"] = adversarial.detach()
        self.g_adam.zero_grad(set_to_none=True)
        total.backward()
        self.g_limit.apply()
        self.g_adam.step()
        self.average.update(generator)
        self.step_index += 1
        return {**losses, "g_loss": total.detach(), "g_l1": l1.detach()}

    def state(self) -> dict[str, Any]:
        """Everything that the next step depends on, as tensors and plain values."""
        return {
            "generator": self.generator.state_dict(),
            "discriminator": self.discriminator.state_dict(),
            "average": self.average.network.state_dict(),
            "average_updates": self.average.updates,
            "g_adam": self.g_adam.state_dict(),
            "d_adam": self.d_adam.state_dict(),
            "limits": [[limit.usual, limit.seen] for limit in (self.g_limit, self.d_limit)],
            "step_index": self.step_index,
            "torch_rng": torch.get_rng_state(),
        }

    def load(self, state: dict[str, Any]) -> None:
        """Continues from state() as if nothing had happened."""
        self.generator.load_state_dict(state["generator"])
        self.discriminator.load_state_dict(state["discriminator"])
        self.average.network.load_state_dict(state["average"])
        self.average.updates = state["average_updates"]
        self.g_adam.load_state_dict(state["g_adam"])
        self.d_adam.load_state_dict(state["d_adam"])
        for limit, (usual, seen) in zip((self.g_limit, self.d_limit), state["limits"], strict=True):
            limit.usual, limit.seen = usual, seen
        self.step_index = state["step_index"]
        torch.set_rng_state(state["torch_rng"])
