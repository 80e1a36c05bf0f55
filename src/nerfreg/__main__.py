"""`python -m nerfreg` is `nerfreg`."""

from __future__ import annotations

import sys

from nerfreg.cli import main

if __name__ == "__main__":
    sys.exit(main())
