"""What is in the wheel."""

from __future__ import annotations

import configparser
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from nerfreg import __version__

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    [path] = folder.glob(f"nerfreg-{__version__}-py3-none-any.whl")
    return zipfile.ZipFile(path)


def test_wheel_holds_every_source_and_config(wheel: zipfile.ZipFile) -> None:
    packages = [ROOT / "src" / "nerfreg", ROOT / "plugins" / "nerfreg_plugins"]
    sources = {
        str(path.relative_to(package.parent))
        for package in packages
        for path in package.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    configs = {f"nerfreg/{path.relative_to(ROOT)}" for path in (ROOT / "conf").rglob("*.yaml")}
    shipped = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert shipped == sources | configs
    assert "nerfreg/conf/config.yaml" in configs
    assert {
        "nerfreg/reports/template/report.html.j2",
        "nerfreg/runs/references.bib",
        "nerfreg_plugins/references.bib",
    } <= sources


def test_wheel_registers_what_pyproject_says(wheel: zipfile.ZipFile) -> None:
    parser = configparser.ConfigParser(delimiters=("=",))
    parser.read_string(wheel.read(f"nerfreg-{__version__}.dist-info/entry_points.txt").decode())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert dict(parser["nerfreg.plugins"]) == project["entry-points"]["nerfreg.plugins"]
    assert dict(parser["console_scripts"]) == {"nerfreg": "nerfreg.cli:main"}
