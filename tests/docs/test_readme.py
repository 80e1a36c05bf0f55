"""The README, which is read where no site is built: its links, its commands, its size."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from nerfreg.cli.parser import make_parser, parsers_of

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
LINK = re.compile(r"\]\((?!https?://)(?P<path>[^)#]+)")


def test_links_lead_somewhere() -> None:
    paths = [match["path"] for match in LINK.finditer(README)]
    assert paths
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_fits_on_a_few_screens() -> None:
    assert len(README.splitlines()) < 120
    assert (ROOT / "docs" / "teaser.jpg").stat().st_size < 300_000


def test_commands_have_known_verbs() -> None:
    lines = [line for line in README.splitlines() if line.startswith("    nerfreg ")]
    verbs = {shlex.split(line)[1] for line in lines}
    assert {"train", "render", "report", "scene"} <= verbs <= parsers_of(make_parser()).keys()
