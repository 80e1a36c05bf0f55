"""Sphinx configuration: `make docs`, strict and without network."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

from nerfreg import __version__

project = "nerfreg"
author = "the authors of nerfreg"
project_copyright = author
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "nerfreg_docs"]
exclude_patterns = ["_build", "_ext", "results"]
nitpicky = True
# Types of other projects, whose documentation a build without network cannot look up.
nitpick_ignore_regex = [
    ("py:.*", r"(torch|nn|numpy|np|jaxtyping|pluggy|omegaconf|mpmath|pathlib|collections)\..*"),
    ("py:.*", r"(Tensor|Module|ndarray|Float|Int|Bool|UInt8|Path)(\[.*)?"),
    ("py:exc", r"(ValueError|TypeError|KeyError|OSError|FileNotFoundError|RuntimeError)"),
]

myst_enable_extensions = ["attrs_inline", "dollarmath"]
myst_heading_anchors = 4

# Docstrings quote code in single backticks, which reStructuredText would set in italics.
default_role = "code"
autodoc_typehints = "none"
# Signatures carry shapes for jaxtyping, which are long; the docstrings tell shapes in words.
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
# One list, without the annotations, which are shapes that Sphinx would take for names to look up.
napoleon_custom_sections = [("Attributes", "params_style")]

highlight_language = "none"
html_theme = "furo"
html_title = f"nerfreg {version}"
html_static_path: list[str] = []
html_show_copyright = False
html_copy_source = False
