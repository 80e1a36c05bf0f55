"""A Sphinx extension that writes the reference pages from the code they describe.

A page holds a comment `<!-- generated: NAME ARGUMENT -->` on a line of its own, which the build
replaces by Markdown.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from nerfreg_docs.command_line import command_line
from nerfreg_docs.configuration import configuration
from nerfreg_docs.hooks import hooks_in_evaluation
from nerfreg_docs.markup import restructured
from nerfreg_docs.modules import modules, names_in_full, names_of_package
from nerfreg_docs.regularizers import regularizers

if TYPE_CHECKING:
    from sphinx.application import Sphinx

MARKER = re.compile(r"^<!-- generated: (\S+)(?: (\S+))? -->$", re.MULTILINE)


def generators() -> dict[str, Callable[..., str]]:
    """The generators by the name that pages call them."""
    return {
        "command_line": command_line,
        "configuration": configuration,
        "hooks_in_evaluation": hooks_in_evaluation,
        "modules": modules,
        "names": names_of_package,
        "names_in_full": names_in_full,
        "regularizers": regularizers,
    }


def fill(text: str) -> str:
    """Replace every marker of a page.

    Raises:
        KeyError: A marker names a generator that does not exist.
    """

    def generated(match: re.Match[str]) -> str:
        arguments = [match[2]] if match[2] else []
        return generators()[match[1]](*arguments)

    return MARKER.sub(generated, text)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension with Sphinx."""

    def read(app: Sphinx, page: str, source: list[str]) -> None:
        if MARKER.search(source[0]):
            # The page depends on code that Sphinx does not track, so every build has to read it.
            app.env.note_reread()
            source[0] = fill(source[0])

    hidden: list[str] = []

    def prepare(app: Sphinx, what: str, *rest: Any) -> None:
        rest[-1][:] = restructured(rest[-1])
        if what in ("attribute", "data", "property"):
            hidden[:] = rest[-1]
            rest[-1].clear()

    def restore(app: Sphinx, what: str, *rest: Any) -> None:
        if what in ("attribute", "data", "property"):
            rest[-1][:] = hidden

    def skip(app: Sphinx, what: str, name: str, thing: object, *rest: Any) -> bool | None:
        # Functions of mpmath are methods of its context and do not look imported.
        return True if what == "module" and inspect.ismethod(thing) else None

    app.connect("source-read", read)
    app.connect("autodoc-skip-member", skip)
    # Napoleon, whose priority is 500, takes what stands before a colon in the docstring of an
    # attribute for its type.
    app.connect("autodoc-process-docstring", prepare, priority=400)
    app.connect("autodoc-process-docstring", restore, priority=600)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
