"""`nerfreg new-plugin`: write a package, and say what to do with it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from nerfreg.errors import NerfregError
from nerfreg.files import write_text
from nerfreg.scaffold.names import plugin_names
from nerfreg.scaffold.package import chosen_hooks, package_files


def run(word: str, hooks: Sequence[str], folder: Path | None = None) -> None:
    """Write a package with a new plugin, and print the next commands.

    Args:
        word: Name of the plugin.
        hooks: Names of the hooks that it implements, or `all`.
        folder: Where the package goes; None: a folder named like the package.

    Raises:
        NerfregError: The name is not free, a hook is not known, or the folder exists.
    """
    names, chosen = plugin_names(word), chosen_hooks(hooks)
    folder = folder or Path(names.distribution)
    if folder.exists():
        raise NerfregError(f"{folder}: exists already; name another folder by --folder")
    for path, text in package_files(names, chosen).items():
        write_text(folder / path, text)
    print(f"{folder}: a package with the plugin {names.plugin} ({', '.join(chosen)}). Next:")
    print(f"  pip install -e {shlex.quote(str(folder))}")
    print(f"  nerfreg check {names.plugin}")
    print(f"  nerfreg train +reg={names.plugin}")
