"""`python -m pave` is the command line.

SPDX-License-Identifier: BSD-3-Clause
"""

from pave.cli import main

if __name__ == "__main__":
    main()
