"""The documentation's own extension, which no package installs."""

from __future__ import annotations

import sys
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"

sys.path.insert(0, str(DOCS / "_ext"))
