"""Adversarial losses and the L1 distance that the two networks are trained with.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch.nn import functional

GAN_MODES = ("bce", "lsgan", "hinge")

# The papers' targets: one-sided smoothing would leave fake at 0, theirs moves both.
REAL_LABEL = 0.9
FAKE_LABEL = 0.1

Loss = Callable[[torch.Tensor], torch.Tensor]


def _towards(distance: Callable[..., torch.Tensor], label: float) -> Loss:
    return lambda logits: distance(logits, torch.full_like(logits, label))


def discriminator_losses(mode: str) -> tuple[Loss, Loss]:
    """Losses of D's patch logits on real and on generated images."""
    if mode == "hinge":
        return lambda x: functional.relu(1 - x).mean(), lambda x: functional.relu(1 + x).mean()
    distance = _DISTANCES[mode]
    return _towards(distance, REAL_LABEL), _towards(distance, FAKE_LABEL)


def generator_loss(mode: str) -> Loss:
    """Loss of D's patch logits on generated images, as the generator sees it: they should pass for real."""
    if mode == "hinge":
        return lambda x: -x.mean()
    return _towards(_DISTANCES[mode], REAL_LABEL)


def probability(logits: torch.Tensor, mode: str) -> torch.Tensor:
    """D's mean output as a number that is 0.5 when it cannot tell real from generated."""
    if mode == "bce":
        return logits.sigmoid().mean()
    if mode == "hinge":
        return (0.5 + 0.5 * logits.clamp(-1, 1)).mean()
    return logits.mean()


_DISTANCES = {
    "bce": functional.binary_cross_entropy_with_logits,
    "lsgan": functional.mse_loss,
}
