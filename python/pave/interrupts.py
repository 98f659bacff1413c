"""Ctrl-C and SIGTERM as a request that long work answers at its next good moment.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """False until SIGINT or SIGTERM comes while the with-block runs; a second one ends the process at once.

    Only the main thread gets signals: in another one it stays False.
    """

    def __init__(self) -> None:
        self.name = ""  # of the signal that came
        self._before: dict[signal.Signals, Any] = {}

    def __bool__(self) -> bool:
        return self.name != ""

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.name = signal.Signals(number).name
        for each in SIGNALS:
            signal.signal(each, signal.SIG_DFL)

    def __exit__(self, *_: object) -> None:
        if not self:  # else the process is about to end, and a second signal may end it sooner
            for number, handler in self._before.items():
                signal.signal(number, handler)
