"""PAVE's errors and the exit code that each one ends a program with.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import enum


class ExitCode(enum.IntEnum):
    """Exit codes of every PAVE program. Also listed in staging/include/pave/error.h and
    docs/errors.md.
    """

    DONE = 0
    RUN = 1
    USAGE = 2
    INPUT = 3
    DEVICE = 4
    PEER = 5


class Error(Exception):
    """Base of all PAVE errors: str(error) is one line that says what went wrong, where, and how to
    mend it.
    """

    exit_code: int = ExitCode.RUN


class RunError(Error):
    """A run that could not go on: disk full, background write failed, cancelled, limit reached."""


class UsageError(Error):
    """The caller asked for something that cannot be: unknown option, size 0, wrong channel name."""

    exit_code = ExitCode.USAGE


class InputError(Error):
    """A file or its data are broken: parse error with file and line, checksum mismatch."""

    exit_code = ExitCode.INPUT


class DeviceError(Error):
    """The OpenCL environment is missing or refused: no platform, unknown device, build failure."""

    exit_code = ExitCode.DEVICE


class ClError(DeviceError):
    """An OpenCL call that failed.

    `routine` is the call ("clBuildProgram"), `code` OpenCL's number, `build_log` the compiler's
    output of a failed build (else empty).
    """

    routine: str = ""
    code: int = 0
    build_log: str = ""


class PeerError(Error):
    """Another process or thread of a stream is late, dead or not the one expected."""

    exit_code = ExitCode.PEER


class InternalError(Error):
    """A broken promise inside PAVE: please report it."""
