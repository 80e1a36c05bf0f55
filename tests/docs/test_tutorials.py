"""Every `console` and `python` block of the tutorials runs, in order, in one folder a page.

A block is stored in a file if the text before it ends in the name of one, such as "`name.py`:".
"""

from __future__ import annotations

from pathlib import Path

import pytest
from nerfreg_docs.blocks import Block, blocks, commands

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("quick_start", *(f"tutorials/{path.stem}" for path in (DOCS / "tutorials").glob("*.md")))


@pytest.mark.parametrize("page", PAGES)
def test_page_runs(page: str, folder: Path, run) -> None:
    for block in blocks((DOCS / f"{page}.md").read_text(encoding="utf-8")):
        if block.file:
            path = folder / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
        elif block.language == "console":
            for words in commands(block.text):
                run(words)
        elif block.language == "python":
            exec(compile(block.text, page, "exec"), {"__name__": "__main__"})


def test_blocks_are_found_with_their_files() -> None:
    page = (
        "Save `a/b.py`:\n\n```python\nx = 1\n```\n\nRun `it`:\n\n```console\n$ nerfreg train\n```\n"
    )
    assert blocks(page) == [
        Block("python", "x = 1\n", "a/b.py"),
        Block("console", "$ nerfreg train\n", None),
    ]


def test_commands_are_told_from_output() -> None:
    text = "$ nerfreg train \\\n  '+reg=[kl]'  # a comment\npsnr 27.3\n$ nerfreg plugins\n"
    assert list(commands(text)) == [["nerfreg", "train", "+reg=[kl]"], ["nerfreg", "plugins"]]
