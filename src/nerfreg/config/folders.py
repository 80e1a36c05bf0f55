"""Folders of configuration files, and the choices that lie in them. Imports nothing heavy."""

from __future__ import annotations

import os
from pathlib import Path


def own_folder() -> Path:
    """Return the package's `conf`: inside the package when installed, at the top of a checkout."""
    package = Path(__file__).parents[1]
    inside, checkout = package / "conf", package.parents[1] / "conf"
    return inside if inside.is_dir() else checkout


def user_folders() -> list[Path]:
    """Return `./conf` and `$XDG_CONFIG_HOME/nerfreg`, where they exist."""
    home = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    folders = [Path.cwd() / "conf", Path(home) / "nerfreg"]
    # In a checkout ./conf is the package's own, which Hydra searches anyway.
    own = own_folder().resolve()
    return [folder for folder in folders if folder.is_dir() and folder.resolve() != own]


def choices_on_disk(group: str) -> set[str]:
    """Return the choices of a configuration group in the package's and the user's folders."""
    folders = [own_folder(), *user_folders()]
    return {path.stem for folder in folders for path in (folder / group).glob("*.yaml")}


def groups_on_disk() -> list[str]:
    """Return the names of the package's configuration groups, Hydra's own left out."""
    return sorted(
        path.name for path in own_folder().iterdir() if path.is_dir() and path.name != "hydra"
    )
