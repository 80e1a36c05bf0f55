"""Packages of strangers, installed for real."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hydra.core.config_store import ConfigStore

PACKAGES = Path(__file__).parent / "packages"
FIXTURES = {"binary", "broken", "namesake", "presets", "twin_a", "twin_b"}
"""The packages that show what the core does with packages; all others are the gallery."""
GALLERY = sorted({path.parent.name for path in PACKAGES.glob("*/pyproject.toml")} - FIXTURES)


def install(target: Path, *names: str) -> Path:
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--target", str(target)]
    subprocess.run([*command, *options, *(str(PACKAGES / name) for name in names)], check=True)
    return target


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Call tests with an argument `package` for each package of the gallery."""
    if "package" in metafunc.fixturenames:
        metafunc.parametrize("package", GALLERY)


@pytest.fixture(scope="session")
def good_packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(tmp_path_factory.mktemp("good"), "binary", "presets")


@pytest.fixture(scope="session")
def bad_packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(tmp_path_factory.mktemp("bad"), "broken", "twin_a", "twin_b")


@pytest.fixture(scope="session")
def namesake_package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(tmp_path_factory.mktemp("namesake"), "namesake")


@pytest.fixture(scope="session")
def gallery_packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(tmp_path_factory.mktemp("gallery"), *GALLERY)


@pytest.fixture
def gallery(gallery_packages: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The gallery is installed; returns the names of its packages."""
    monkeypatch.syspath_prepend(gallery_packages)
    return GALLERY


@pytest.fixture(autouse=True)
def forget_strangers() -> Iterator[None]:
    """What a test registers must not be known to the next."""
    yield
    ConfigStore.instance().repo.pop("reg", None)
