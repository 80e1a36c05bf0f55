"""Markdown tables and what has to be escaped in them."""

from __future__ import annotations

from collections.abc import Sequence


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of cells that are Markdown already."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(cell, line))} |" for line in lines)


def cell(text: str) -> str:
    """Text in one line whose bars do not end the cell."""
    return " ".join(text.split()).replace("|", "\\|")


def code(text: str) -> str:
    """Text as it is typed; nothing for empty text."""
    return f"`{text}`" if text else ""


def plain(text: str) -> str:
    """Plain text, outside of backticks, whose characters Markdown must not interpret."""
    parts = text.split("`")
    for index in range(0, len(parts), 2):
        for character in "\\*_<[":
            parts[index] = parts[index].replace(character, f"\\{character}")
    return "`".join(parts)
