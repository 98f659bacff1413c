"""Makes tests/data/tiny-run: an untrained generator of two filters, for tests that need weights but no skill.

SPDX-License-Identifier: BSD-3-Clause

    python tests/data/make_tiny_run.py
"""

from pathlib import Path

import torch

from pave.export import export_generator
from pave.models import Generator, GeneratorOptions
from pave.schema import ENCODINGS, PLANES, InputSpec, Schema

CHANNELS = ("albedo", "direct", "normal", "depth")


def main() -> None:
    torch.manual_seed(1)
    specs = tuple(
        InputSpec(name, PLANES.get(name, 3), ENCODINGS[name], 1, 4.0, (0.0, 0.0, 0.0), 1.0)
        for name in CHANNELS
    )
    schema = Schema(specs, 20.0)
    options = GeneratorOptions(filters=2, unet_depth=2)
    network = Generator(schema.in_planes, options, direct_first=schema.first_plane("direct"))
    folder = Path(__file__).parent / "tiny-run"
    folder.mkdir(exist_ok=True)
    print(export_generator(folder, network, schema, {"note": "untrained"}))


if __name__ == "__main__":
    main()
