"""`pave bench NAME`: runs one bench and prints its lines, or a table of them.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import importlib
from typing import Annotated, Any

import typer

from pave.console import Console
from pave.errors import UsageError

BENCHES = {
    "cornell": "paths a second in a small scene",
    "mesh": "paths a second with 250,000 triangles",
    "equal-time": "squared error after equal time",
    "dataset": "training views a second, and hours for the papers' data set",
    "startup": "seconds of a small render, with and without compiled kernels",
    "rays": "rays a second, beside Embree",
    "build": "time to the first ray, beside Embree",
}


def bench(
    name: Annotated[str, typer.Argument(help=", ".join(BENCHES) + ".")],
    peers: Annotated[bool, typer.Option("--peers", help="Run the peer beside PAVE.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Tiny: a check, no figures.")] = False,
    rounds: Annotated[
        int | None, typer.Option(help="Rounds that count. Default: 3 to 7, by bench.")
    ] = None,
    device: Annotated[str, typer.Option("--device", help="As in render.")] = "",
    json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
) -> None:
    """Measure PAVE, with --peers beside other programs in the same rounds; a wrong answer prints no number."""
    from pave.bench.common import Bench, Options

    if name not in BENCHES:
        raise UsageError(f"no bench '{name}'; there are {', '.join(BENCHES)}")
    if rounds is not None and not 1 <= rounds <= 1000:
        raise UsageError(f"--rounds {rounds} is outside 1..1000")
    console = Console(json)
    options = Options(peers, quick, rounds, device)
    run = Bench(name, console, options)
    try:
        importlib.import_module(f"pave.bench.{name.replace('-', '_')}").run(run)
    finally:
        run.clear()
        if run.records and not json:
            print_table(run.records)


def print_table(records: list[dict[str, Any]]) -> None:
    """The lines for people, on stdout."""
    from rich.console import Console as RichConsole
    from rich.table import Table

    first = records[0]
    table = Table(
        title=f"{first['bench']} on {first['device']}, {first['driver']}, commit {first['commit']}"
    )
    for column in ("case", "PAVE", "peer", "unit", "ratio", "n", "spread", "mean"):
        left = column in ("case", "unit")
        table.add_column(column, justify="left" if left else "right", no_wrap=True)
    for line in records:
        mean = _number(line["mean"])
        if line["mean_error"] is not None:
            mean += f" ± {line['mean_error']:.1e}"
        table.add_row(
            line["case"],
            _number(line["value"]),
            _number(line["peer_value"]),
            line["unit"],
            _number(line["ratio"], 3),
            str(line["n"]),
            "" if line["spread"] is None else f"{100 * line['spread']:.1f} %",
            mean,
        )
    peers = sorted({line["peer"] for line in records if line["peer"]})
    if peers:
        table.caption = "peer: " + ", ".join(peers) + "; a ratio above 1: PAVE is ahead"
    out = RichConsole()
    out.width = max(out.width, 100)  # in a pipe too a row is a line
    out.print(table)


def _number(value: float | None, digits: int = 4) -> str:
    if value is None:
        return ""
    for scale, letter in ((1e6, " M"), (1e3, " k")):
        if abs(value) >= scale:
            return f"{value / scale:.{digits}g}{letter}"
    return f"{value:.{digits}g}"
