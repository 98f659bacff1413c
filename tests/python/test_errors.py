"""Errors cross the edge once, as the class and with the exit code that C++ gave them, in one line.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap

import pytest

import pave

EXIT_CODES = {
    pave.Error: 1,
    pave.RunError: 1,
    pave.UsageError: 2,
    pave.InputError: 3,
    pave.DeviceError: 4,
    pave.ClError: 4,
    pave.PeerError: 5,
    pave.InternalError: 1,
}


def test_exit_codes_and_family():
    for kind, code in EXIT_CODES.items():
        assert kind.exit_code == code
        assert issubclass(kind, pave.Error)
        assert kind("text").exit_code == code
    assert issubclass(pave.ClError, pave.DeviceError)
    assert not issubclass(pave.Error, RuntimeError)
    assert [code.value for code in pave.ExitCode] == [0, 1, 2, 3, 4, 5]


def usage():
    pave._pave.make_schema(0, 4, [("color", 3)])


def bad_input():
    pave.load_scene("no-such-scene")


def device():
    pave.Device("no such device")


def run():
    stage = pave.Stage(None, "mem:", width=8, height=8, slots=1, timeout=0.01)
    held = stage.acquire()
    stage.acquire()
    del held


def peer():
    with (
        pave.Stage(None, "mem:peer", width=8, height=8),
        pave.Source("mem:peer") as source,
    ):
        source.next(timeout=0.01)


def internal():
    pave.make_frame(None, 8, 8, ["depth"])._frame.planes(1 << 20, 3)


@pytest.mark.parametrize(
    ("provoke", "kind"),
    [
        (usage, pave.UsageError),
        (bad_input, pave.InputError),
        (device, pave.DeviceError),
        (run, pave.RunError),
        (peer, pave.PeerError),
        (internal, pave.InternalError),
    ],
)
def test_what_the_library_throws_arrives_as_its_own_class(provoke, kind):
    with pytest.raises(pave.Error) as caught:
        provoke()
    assert type(caught.value) is kind
    assert str(caught.value).strip()
    assert "\n" not in str(caught.value)


WRONG = {
    "policy": lambda: pave.Stage(None, "mem:", policy="never"),
    "timeout": lambda: pave.Stage(None, "mem:", timeout=-1),
    "timeout type": lambda: pave.Stage(None, "mem:", timeout="soon"),
    "width": lambda: pave.Stage(None, "mem:", width=2**40),
    "height": lambda: pave.Stage(None, "mem:", height=1.5),
    "slots": lambda: pave.Stage(None, "mem:", slots=0),
    "uri": lambda: pave.Stage(None, "nowhere"),
    "channel twice": lambda: pave.Stage(None, "mem:", channels=["color", "color"]),
    "planes": lambda: pave.Stage(None, "mem:", channels=[("heat", 0)]),
    "device": lambda: pave.Stage("cpu", "mem:"),
    "view shape": lambda: pave.View([[1, 0], [0, 1]]),
    "view nan": lambda: pave.View([[float("nan")] * 4] * 4),
    "view type": lambda: pave.View("front"),
    "fov": lambda: pave.look_at((0, 0, 0), (0, 0, 1), fov=180),
    "eye is target": lambda: pave.look_at((1, 2, 3), (1, 2, 3)),
    "up": lambda: pave.look_at((0, 0, 0), (0, 1, 0)),
    "point": lambda: pave.look_at((0, 0), (0, 1, 0)),
    "point type": lambda: pave.look_at("here", (0, 1, 0)),
    "foreign frame": lambda: pave.Stage(None, "mem:").publish(
        pave.make_frame(None, 256, 256, ["color"])
    ),
    "views": lambda: pave.hemisphere_views(pave.load_scene("cornell"), -1),
    "view seed": lambda: pave.hemisphere_views(pave.load_scene("cornell"), 1, seed=-1),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_arguments_are_usage_errors(what):
    with pytest.raises(pave.UsageError) as caught:
        WRONG[what]()
    assert "\n" not in str(caught.value)


def test_no_platform_says_what_to_install():
    code = """
        import pave
        try:
            pave.Device()
        except pave.DeviceError as error:
            print(error)
            raise SystemExit(error.exit_code)
    """
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        env={**os.environ, "OCL_ICD_VENDORS": "/nowhere", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 4, result.stderr
    assert "apt install pocl-opencl-icd" in result.stdout
