"""The Python of the how-to pages for plugins and for other programs runs as it is printed."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import pytest

HOWTO = Path(__file__).parents[2] / "docs" / "howto"


def python_of(page: str) -> dict[str, str]:
    """The Python blocks of a page by the heading that they stand under; at most one each."""
    text = (HOWTO / f"{page}.md").read_text(encoding="utf-8")
    heads = re.split(r"^## (.*)$", text, flags=re.M)
    found = {}
    for heading, body in zip(heads[1::2], heads[2::2], strict=True):
        [block] = re.findall(r"^```python\n(.*?)^```$", body, flags=re.M | re.S)
        found[heading] = block
    return found


def run(page: str, heading: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(compile(python_of(page)[heading], f"{page}.md, {heading}", "exec"), names)
    return names


def test_losses_in_plain_torch() -> None:
    names = run("foreign_code", "Plain torch")
    assert names["density"].grad.isfinite().all()
    assert names["density"].grad.any(dim=1).all()


def test_losses_with_nerfacc() -> None:
    pytest.importorskip("nerfacc", reason="nerfacc is not installed")
    names = run("foreign_code", "nerfacc")
    assert names["sigmas"].grad.isfinite().all()
    assert names["sigmas"].grad.any(dim=1).all()


def test_losses_with_nerfstudio() -> None:
    pytest.importorskip("nerfstudio.cameras.rays", reason="nerfstudio is not installed")
    names = run("foreign_code", "nerfstudio")
    assert names["weights"].shape == (256, 48, 1)
    assert names["densities"].grad.isfinite().all()
    assert names["densities"].grad.any(dim=1).all()


def test_assertions() -> None:
    run("test_a_plugin", "Assertions")["test_thin"]()


@pytest.mark.parametrize("heading", ["Values worked out by hand", "Short trainings"])
def test_examples_hold(heading: str) -> None:
    run("test_a_plugin", heading)


def test_fixtures_are_those_of_the_package() -> None:
    # What they do is shown by tests/testing/test_fixtures.py.
    block = python_of("test_a_plugin")["Fixtures"]
    assert block == 'pytest_plugins = ["nerfreg.testing.fixtures"]\n'
    fixtures = (Path(__file__).parents[2] / "src/nerfreg/testing/fixtures.py").read_text("utf-8")
    text = (HOWTO / "test_a_plugin.md").read_text(encoding="utf-8")
    for name in re.findall(r"^def (\w+)\(", fixtures, flags=re.M):
        assert f"`{name}`" in text


def test_every_function_is_listed_with_its_arguments() -> None:
    text = (HOWTO / "foreign_code.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(nerfreg_plugins[\w.]+)` \| `([^`]+)`", text, flags=re.M)
    assert len(rows) == 10
    for path, arguments in rows:
        module, _, name = path.rpartition(".")
        parameters = inspect.signature(getattr(importlib.import_module(module), name)).parameters
        listed = [
            p.name if p.default is p.empty else f"{p.name}={p.default}" for p in parameters.values()
        ]
        assert arguments == ", ".join(listed)
