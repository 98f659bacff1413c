"""Renders PAVE's scenes with Mitsuba and stores mean and variance in tests/data/mitsuba.

SPDX-License-Identifier: BSD-3-Clause

    python tests/python/make_references.py [SCENE ...]

Takes some minutes a scene. The files are made once; tests compare PAVE with them.
"""

from __future__ import annotations

import sys
import time

import mitsuba_reference as reference


def main(names: list[str]) -> int:
    mitsuba = reference.import_mitsuba()
    if mitsuba.__version__ != reference.VERSION:
        print(f"Mitsuba {reference.VERSION} is wanted, not {mitsuba.__version__}", file=sys.stderr)
        return 2
    unknown = [name for name in names if name not in reference.RECIPES]
    if unknown:
        print(f"no recipe for {unknown}; there are {list(reference.RECIPES)}", file=sys.stderr)
        return 2
    for name in names or reference.RECIPES:
        start = time.monotonic()
        recipe = reference.RECIPES[name]
        command = f"python tests/python/make_references.py {name}"
        reference.store(recipe, reference.make(recipe), command)
        byte_size = recipe.path.stat().st_size
        print(f"{recipe.path.name}: {byte_size} bytes, {time.monotonic() - start:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
