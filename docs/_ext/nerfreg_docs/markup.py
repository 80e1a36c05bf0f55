"""From docstrings, which are plain text with code in backticks, to reStructuredText.

Docstrings are written for readers of the code. Sections are left to Sphinx's Napoleon.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

SPECIAL = re.compile(r"\||\*(?=\S)|(?<=\w)_(?!\w)")
"""What reStructuredText would take for a substitution, emphasis or a link."""


RETURNS = ("Returns:", "Yields:")


def restructured(lines: Sequence[str]) -> list[str]:
    """Mark indented blocks as literal, and escape what is no markup.

    A block is literal if a line that ends in a colon and an empty line come before it; the items
    of a section such as `Args:` follow it without an empty line.
    """
    result: list[str] = []
    code = False
    literal: int | None = None
    for number, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if literal is not None and (not line.strip() or indent > literal):
            result.append(line)
            continue
        literal = indent if _introduces_block(lines, number) else None
        parts = line.split("`")
        for index, part in enumerate(parts):
            if not code:
                parts[index] = SPECIAL.sub(lambda match: f"\\{match[0]}", part)
            if index < len(parts) - 1:
                code = not code
        text = "`".join(parts)
        if number and lines[number - 1].strip() in RETURNS:
            # Napoleon would take text before a colon for a type, so it gets an empty one.
            text = f"{text[:indent]}: {text[indent:]}"
        result.append(f"{text}:" if literal is not None and not text.endswith("::") else text)
    return result


def _introduces_block(lines: Sequence[str], number: int) -> bool:
    line, following = lines[number], lines[number + 1 : number + 3]
    if not line.endswith(":") or len(following) < 2 or following[0].strip():
        return False
    return following[1].startswith(" " * (len(line) - len(line.lstrip()) + 1))
