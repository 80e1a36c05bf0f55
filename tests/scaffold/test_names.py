from __future__ import annotations

import keyword
from pathlib import Path

import pytest

from nerfreg import NerfregError
from nerfreg.cli import main
from nerfreg.scaffold.names import plugin_names
from nerfreg.scaffold.package import CHOICES, chosen_hooks


def test_all_names_follow_from_one() -> None:
    names = plugin_names("depth-ranking")
    assert names.plugin == "depth_ranking"
    assert names.distribution == "nerfreg-depth-ranking"
    assert names.module == "nerfreg_depth_ranking"
    assert names.cls == "DepthRanking"
    assert plugin_names("depth_ranking") == names


@pytest.mark.parametrize("word", ["rays", "schedule", "occupancy_grid", "frequencies"])
def test_class_hides_nothing_that_is_imported(word: str) -> None:
    assert plugin_names(word).cls.endswith("Regularizer")


@pytest.mark.parametrize("word", ["", "Depth", "2d", "a b", "a__b", "_a", "a_", "a.b", "é", "-h1"])
def test_what_is_no_name(word: str) -> None:
    with pytest.raises(NerfregError, match=r"is no name for a plugin; use lower-case letters"):
        plugin_names(word)


@pytest.mark.parametrize(
    ("word", "reason"),
    [
        ("kl", r"^'kl' is a plugin of nerfreg already"),
        ("full-geometry", r"^'full-geometry' is a plugin of nerfreg already"),
        ("combinerf", r"^'combinerf' is a preset already"),
        ("plugins", r"^'plugins' needs a module nerfreg_plugins, which is installed"),
        ("null", r"^'null' is a value in configurations"),
        ("compositing", r"^'compositing' is a part of nerfreg"),
    ],
)
def test_what_is_taken(word: str, reason: str) -> None:
    with pytest.raises(NerfregError, match=f"{reason}; choose another name$"):
        plugin_names(word)


def test_a_keyword_is_a_fine_name() -> None:
    names = plugin_names("lambda")
    assert not keyword.iskeyword(names.module)
    assert not keyword.iskeyword(names.cls)


def test_hooks_in_the_order_of_a_run_with_what_they_need() -> None:
    assert chosen_hooks(["reference", "nerfreg_needs"]) == ("needs", "loss", "reference")
    assert chosen_hooks(["module"]) == ("module", "color_input")
    assert chosen_hooks(["all"]) == CHOICES


def test_unknown_hook() -> None:
    with pytest.raises(NerfregError, match=r"^--hook los: did you mean 'loss'\?$"):
        chosen_hooks(["los"])
    with pytest.raises(NerfregError, match=r"^--hook needs a value"):
        chosen_hooks([])


def test_a_folder_that_exists_stays_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").mkdir()
    assert main(["new-plugin", "mine", "--folder", str(tmp_path / "mine")]) == 2
    expected = f"nerfreg: error: {tmp_path / 'mine'}: exists already; name another folder by"
    assert capsys.readouterr().err.startswith(expected)
    assert not list((tmp_path / "mine").iterdir())


def test_next_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new-plugin", "my-own"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "nerfreg-my-own: a package with the plugin my_own (loss). Next:",
        "  pip install -e nerfreg-my-own",
        "  nerfreg check my_own",
        "  nerfreg train +reg=my_own",
    ]
    assert {str(path.relative_to("nerfreg-my-own")) for path in Path().rglob("*.*")} >= {
        "pyproject.toml",
        "README.md",
        "nerfreg_my_own/__init__.py",
        "tests/test_my_own.py",
        ".github/workflows/ci.yml",
    }
