"""What a data set or a run folder holds, verified first.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pave.errors import InputError, UsageError


def describe(what: str) -> dict[str, Any]:
    """Record of a data set ("bp:PATH", "exr:DIR") or of a run folder. Raises InputError for broken data."""
    if what.startswith(("bp:", "exr:")):
        return _describe_dataset(what)
    folder = Path(what)
    if (folder / "generator.json").exists():
        return _describe_run(folder)
    raise UsageError(f"'{what}' is neither bp:PATH, exr:DIR nor a run folder with a generator.json")


def _describe_dataset(uri: str) -> dict[str, Any]:
    import pave

    source = pave.Source(uri, allow_unfinished=True)
    for position in range(len(source)):
        source.read(position)  # every checksum is compared on the way
    record: dict[str, Any] = {
        "uri": uri,
        "frames": len(source),
        "finished": source.finished,
        "width": source.width,
        "height": source.height,
        "channels": source.channels,
        "content_hash": source.content_hash,
        "verified": True,
    }
    if len(source):
        record["first_frame"] = dict(source.metadata(0))
    return record


def _describe_run(folder: Path) -> dict[str, Any]:
    import pave

    generator = pave.Generator(pave.Device(), str(folder))  # verifies both files
    try:
        schema = json.loads((folder / "generator.json").read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}/generator.json: {error}") from error
    return {
        "run": str(folder),
        "inputs": schema["inputs"],
        "output": schema["output"],
        "transfer": schema["transfer"],
        "nodes": len(schema["nodes"]),
        "weights_version": generator.weights_version,
        "training": schema.get("training", {}),
        "verified": True,
    }
