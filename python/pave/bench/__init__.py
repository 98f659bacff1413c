"""Benches: each answers one question, validates before it times, and can run a peer in the same rounds.

SPDX-License-Identifier: BSD-3-Clause

One module a question with one function `run(bench)`; `common` measures and prints, `subjects` holds
what is measured: PAVE and Mitsuba on one scene file.
"""
