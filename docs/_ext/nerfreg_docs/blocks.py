"""The fenced blocks of a page, and the commands in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass

BLOCK = re.compile(r"(?P<before>[^\n]*)\n\n```(?P<language>\w+)\n(?P<text>.*?)^```$", re.M | re.S)
FILE = re.compile(r"`(?P<name>[\w./-]+\.\w+)`[^`]*:$")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page.

    Attributes:
        language: What stands behind the fence.
        text: What it holds.
        file: Where the page stores it; None for what is run.
    """

    language: str
    text: str
    file: str | None


def blocks(page: str) -> list[Block]:
    """The fenced blocks of a page's source, in order."""
    found = []
    for match in BLOCK.finditer(page):
        named = FILE.search(match["before"])
        found.append(Block(match["language"], match["text"], named["name"] if named else None))
    return found


def commands(text: str) -> Iterator[list[str]]:
    """The words of each command that follows a prompt; comments are left out."""
    for line in text.replace("\\\n", " ").splitlines():
        if line.startswith("$ "):
            yield shlex.split(line.removeprefix("$ "), comments=True)
