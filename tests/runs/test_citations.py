"""Where the BibTeX entries of the core and of plugins come from."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest

from nerfreg.errors import NerfregError
from nerfreg.hooks import Regularizer
from nerfreg.runs.citations import cite, plugin_entries

ONE, TWO = "@misc{one2020, title = {One}}", "@article{two2021,\n  title = {Two}\n}"
MODULE = """
from dataclasses import dataclass
from typing import ClassVar
from nerfreg import Regularizer

@dataclass
class Plugin(Regularizer):
    cite: ClassVar[str] = "two2021, one2020"
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> str:
    """The name of a package `NAME.inner.module` whose outer package has a bibliography."""
    name = f"cited_{request.node.name.partition('[')[0]}"
    inner = tmp_path / name / "inner"
    inner.mkdir(parents=True)
    (inner.parent / "__init__.py").touch()
    (inner / "__init__.py").touch()
    (inner / "module.py").write_text(MODULE)
    (inner.parent / "references.bib").write_text(f"% What is cited.\n\n{ONE}\n\n{TWO}\n")
    monkeypatch.syspath_prepend(tmp_path)
    return name


def plugin(package: str) -> type[Regularizer]:
    return importlib.import_module(f"{package}.inner.module").Plugin


def test_keys_are_found_in_a_parent_package(package: str) -> None:
    entries = plugin_entries("mine", plugin(package))
    assert list(entries.items()) == [("two2021", TWO), ("one2020", ONE)]


def test_the_closest_file_counts(package: str, tmp_path: Path) -> None:
    closer = "@misc{one2020, title = {Another}}"
    (tmp_path / package / "inner" / "references.bib").write_text(f"{closer}\n{TWO}\n")
    assert plugin_entries("mine", plugin(package))["one2020"] == closer


def test_a_subclass_elsewhere_inherits_the_sources(package: str) -> None:
    @dataclass
    class Derived(plugin(package)):
        pass

    assert list(plugin_entries("derived", Derived)) == ["two2021", "one2020"]


def test_an_unknown_key_is_refused(package: str, tmp_path: Path) -> None:
    cls = plugin(package)
    cls.cite = "one2020, two2012"
    with pytest.raises(NerfregError) as caught:
        plugin_entries("mine", cls)
    file = tmp_path / package / "references.bib"
    assert str(caught.value) == (
        f"plugin mine: cites 'two2012', not in {file}; did you mean 'two2021'?"
    )


def test_keys_without_a_file_are_refused(package: str, tmp_path: Path) -> None:
    (tmp_path / package / "references.bib").unlink()
    with pytest.raises(NerfregError, match=r"plugin mine: cites 'two2021, one2020', but there is"):
        plugin_entries("mine", plugin(package))


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ("", []),
        (ONE, ["one2020"]),
        (f"{ONE}\n\n{TWO}", ["one2020", "two2021"]),
        (f"\n    {ONE}\n    {ONE}\n", ["one2020"]),
    ],
)
def test_text_is_taken_as_it_is(text: str, keys: list[str]) -> None:
    @dataclass
    class Plugin(Regularizer):
        cite: ClassVar[str] = text

    entries = plugin_entries("mine", Plugin)
    assert list(entries) == keys
    assert all(entry in text for entry in entries.values())


@pytest.mark.parametrize(("lpips", "last"), [("true", "zhang2018unreasonable"), ("false", "king")])
def test_a_run_without_plugins_cites_the_core(tmp_path: Path, lpips: str, last: str) -> None:
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "config.yaml").write_text(f"reg: {{}}\neval: {{lpips: {lpips}}}\n")
    entries = cite(tmp_path).split("\n\n")
    assert entries[0].startswith("@inproceedings{mildenhall2020nerf,\n")
    assert entries[1].startswith("@article{muller2022instant,\n")
    assert entries[-1].startswith(f"@inproceedings{{{last}")
