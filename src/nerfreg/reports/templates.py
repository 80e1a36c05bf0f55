"""Templates: what turns tables into Markdown, LaTeX and HTML, one file for each format."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template

from nerfreg.reports.records import slug

FOLDER = Path(__file__).parent / "template"
LATEX = {
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "±": r"$\pm$",
    "≤": r"$\le$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
}


def template(name: str) -> Template:
    """Return a template by the name of its file; what is put into HTML is escaped."""
    environment = Environment(
        loader=FileSystemLoader(FOLDER),
        autoescape=lambda file: bool(file) and ".html" in str(file),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(
        latex=latex_text, markdown=markdown_text, shell=shlex.join, slug=slug
    )
    return environment.get_template(name)


def latex_text(text: str) -> str:
    """Return text that means itself in LaTeX."""
    return "".join(LATEX.get(letter, letter) for letter in text)


def markdown_text(text: str) -> str:
    """Return text that means itself in Markdown, in a cell of a table too."""
    return re.sub(r"([\\|*<>\[\]`])", r"\\\1", text)
