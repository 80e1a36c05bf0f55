"""Packages that `nerfreg new-plugin` has written, installed for real."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from nerfreg.cli import main
from nerfreg.scaffold.package import CHOICES

NAMES = {"all": "every_hook", **{hook: f"only_{hook}" for hook in CHOICES}}
"""The plugins by the hooks that they are asked for with."""


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which there is a package for each of `NAMES`, named like the plugin."""
    folder = tmp_path_factory.mktemp("written")
    for hook, name in NAMES.items():
        assert main(["new-plugin", name, "--hook", hook, "--folder", str(folder / name)]) == 0
    return folder


@pytest.fixture(scope="session")
def installed_packages(written: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder into which pip has installed them all."""
    target = tmp_path_factory.mktemp("installed")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--target", str(target)]
    packages = [str(written / name) for name in NAMES.values()]
    subprocess.run([*command, *options, *packages], check=True)
    return target
