"""Checks of arguments before they reach the library: a wrong number is the caller's mistake, told in one line.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import operator
from typing import Any

from pave.errors import UsageError

INT32_MAX = 2**31 - 1
INT64_MAX = 2**63 - 1
UINT64_MAX = 2**64 - 1


def whole(name: str, value: Any, low: int = -INT32_MAX, high: int = INT32_MAX) -> int:
    """`value` as an int from `low` to `high`, numpy's integers included; UsageError otherwise."""
    try:
        number = operator.index(value)
    except TypeError as error:
        raise UsageError(f"{name} must be a whole number, not {value!r}") from error
    if not low <= number <= high:
        raise UsageError(f"{name} {number} is outside {low}..{high}")
    return number


def seconds(name: str, value: Any) -> int:
    """A time-out in seconds, 0 to 1e9, as whole milliseconds; UsageError otherwise."""
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} must be a number of seconds, not {value!r}") from error
    if not 0 <= number <= 1e9:
        raise UsageError(f"{name} of {number} s is outside 0..1e9")
    return int(number * 1000)
