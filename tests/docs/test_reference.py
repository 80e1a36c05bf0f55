"""The generated reference: what it says of small parsers and classes, and that it covers ours."""

from __future__ import annotations

import argparse
import dataclasses
import re
from dataclasses import dataclass
from typing import Any, Literal

import pytest
from nerfreg_docs import fill
from nerfreg_docs.command_line import command_line, describe
from nerfreg_docs.configuration import _split_by_layout, configuration
from nerfreg_docs.docstrings import attributes, summary
from nerfreg_docs.fields import fields_table, type_name, yaml_value
from nerfreg_docs.hooks import hooks_in_evaluation
from nerfreg_docs.markdown import plain, table
from nerfreg_docs.markup import restructured
from nerfreg_docs.modules import modules, names_in_full, names_of_package
from nerfreg_docs.regularizers import own_plugins, regularizers

import nerfreg
from nerfreg.cli.parser import make_parser, parsers_of
from nerfreg.config.schema import Config
from nerfreg.hooks import ALWAYS_IN_EVALUATION, IN_EVALUATION_IF_ASKED
from nerfreg.scenes import SCENES


@dataclass
class Base:
    """A base class.

    Attributes:
        width: Pixels of a row.
        depth: What the subclass says differently.
    """

    width: int = 3
    depth: float | None = None


@dataclass
class Derived(Base):
    """First line.

    More words.

    Attributes:
        depth: Metres, or None
            if unknown: a guess.
        names (list): Labels | tags.

    Raises:
        ValueError: never.
    """

    names: list[str] = dataclasses.field(default_factory=lambda: ["a"])


def test_attributes_of_a_class_and_its_bases() -> None:
    assert attributes(Derived) == {
        "width": "Pixels of a row.",
        "depth": "Metres, or None if unknown: a guess.",
        "names": "Labels | tags.",
    }
    assert summary(Derived) == "First line."


def test_table_of_fields() -> None:
    assert fields_table("x.", Derived, {"width": 4}, {"forward": {"depth": 2.5}}).splitlines() == [
        "| key | type | default | meaning |",
        "| --- | --- | --- | --- |",
        "| `x.width` | int | `4` | Pixels of a row. |",
        "| `x.depth` | float or null | `null`; forward: `2.5` | "
        "Metres, or None if unknown: a guess. |",
        "| `x.names` | list of string | `[a]` | Labels \\| tags. |",
    ]


@pytest.mark.parametrize(
    ("hint", "name"),
    [
        (bool, "bool"),
        (str | None, "string or null"),
        (list[int] | None, "list of int or null"),
        (list[Any], "list"),
        (dict[str, float], "map to float"),
        (Literal["mean", "sum"] | None, "mean or sum or null"),
    ],
)
def test_type_names(hint: Any, name: str) -> None:
    assert type_name(hint) == name


def test_values_as_they_are_typed() -> None:
    assert [yaml_value(value) for value in (None, True, 0.5, ["a", None])] == [
        "null",
        "true",
        "0.5",
        "[a, null]",
    ]


def test_text_is_escaped_but_not_code() -> None:
    assert plain("a*b_c `d*e_f` <g>") == "a\\*b\\_c `d*e_f` \\<g>"
    assert table(["a"], [["b | c\nd"]]) == "| a |\n| --- |\n| b \\| c d |"


def test_docstrings_become_restructured_text() -> None:
    lines = [
        "|x| and a*b, `|y| *z",
        "w_` v_ and a * b, u_v.",
        "",
        "A wrapper:",
        "",
        "    a*b",
        "",
        "End",
    ]
    assert restructured(lines) == [
        "\\|x\\| and a\\*b, `|y| *z",
        "w_` v\\_ and a * b, u_v.",
        "",
        "A wrapper::",
        "",
        "    a*b",
        "",
        "End",
    ]
    section = ["Args:", "    n: Length.", "", "Returns:", "    Its square."]
    assert restructured(section) == [*section[:-1], "    : Its square."]


def test_parser_with_commands() -> None:
    parser = argparse.ArgumentParser("tool", description="Does things.")
    commands = parser.add_subparsers()
    run = commands.add_parser("run", description="Runs.", epilog="An\n  example.")
    run.add_argument("folder", help="where to")
    run.add_argument(
        "-n", "--number", metavar="N", type=int, default=2, help="how many, %(default)s"
    )
    run.add_argument("--quick", action="store_true", help="on less")
    run.add_argument("--hidden", help=argparse.SUPPRESS)
    assert describe(parser).split("\n\n") == [
        "```text\ntool [-h] {run} ...\n```",
        "Does things.",
        "## tool run",
        "```text\ntool run [-h] [-n N] [--quick] folder\n```",
        "Runs.",
        "| argument | meaning |\n| --- | --- |\n"
        "| `folder` | where to |\n"
        "| `-n N`, `--number N` | how many, 2 |\n"
        "| `--quick` | on less |",
        "```text\nAn\n  example.\n```",
    ]


def test_markers_are_replaced() -> None:
    assert fill("before\n\n<!-- generated: names nerfreg -->\n") == (
        f"before\n\n{names_of_package('nerfreg')}\n"
    )
    with pytest.raises(KeyError):
        fill("<!-- generated: nothing -->")


def test_command_line_has_every_verb() -> None:
    page = command_line()
    for verb in parsers_of(make_parser()):
        assert f"## nerfreg {verb}\n" in page


def test_configuration_has_every_key() -> None:
    page = configuration()
    for field in dataclasses.fields(Config):
        value = getattr(Config(), field.name)
        if dataclasses.is_dataclass(value):
            for key in dataclasses.fields(value):
                assert f"| `{field.name}.{key.name}` |" in page
    for name, cls in SCENES.items():
        assert f"### `scene={name}`" in page
        for key in dataclasses.fields(cls):
            assert f"| `scene.{key.name}` |" in page
    # Their docstrings have an item for each.
    assert [line for line in page.splitlines() if line.endswith("|  |")] == []
    for plugin in own_plugins():
        assert plugin.cls is not None
        for key in dataclasses.fields(plugin.cls):
            assert f"| `reg.{plugin.name}.{key.name}` |" in page


def test_defaults_are_those_of_the_files() -> None:
    page = configuration()
    # conf/field/hash_grid.yaml: ${by_layout:2048,1024,2048}; conf/scene/llff.yaml: views: 3
    assert "| `field.finest` | int | `1024`; forward: `2048`; room: `2048` |" in page
    assert "| `scene.views` | int or null | `3` |" in page
    assert "also sets `train.rays=512`, `train.steps=1500`" in page
    assert "| `+reg=combinerf` |" in page
    assert "| `sampler=importance` |" in page


def test_values_of_presets_are_listed_by_kind_of_capture() -> None:
    values = {"a": "${by_layout:1,2}", "b": "${by_layout:1,2,3}", "c": 4}
    plain_values, by_layout = _split_by_layout(values)
    assert plain_values == {"a": "2", "b": "2", "c": 4}
    assert by_layout == {"forward": {"a": "1", "b": "1"}, "room": {"b": "3"}}


def test_regularizers_are_indexed() -> None:
    page = regularizers()
    for plugin in own_plugins():
        assert f"](../regularizers/{plugin.name}.md)" in page


def test_modules_are_found() -> None:
    page = modules("nerfreg.scenes")
    assert ".. automodule:: nerfreg.scenes.cameras\n   :members:" in page
    names = names_of_package("nerfreg")
    assert "{py:class}`Rendering <nerfreg.hooks.samples.Rendering>`" in names
    assert "{py:func}`read_image <nerfreg.scenes.images.read_image>` | Read an image." in names
    assert [line for line in names.splitlines() if line.endswith("|  |")] == []
    assert all(f"`{name}" in names for name in nerfreg.__all__)


def test_promised_names_are_documented_in_full() -> None:
    page = names_in_full("nerfreg")
    assert "never removed or changed in meaning without having been" in " ".join(page.split())
    for name in nerfreg.__all__:
        assert f"## `nerfreg.{name}`\n\n" in page
    assert ".. autoclass:: nerfreg.hooks.step.Step\n   :members:" in page
    assert ".. autofunction:: nerfreg.scenes.images.read_image\n   :no-index:" in page


def test_hooks_of_evaluation_are_those_of_the_specifications() -> None:
    names = re.findall(r"^\| {py:meth}`(\w+) <.*>` \| (\w+) ", hooks_in_evaluation(), flags=re.M)
    assert names == [
        *((name, "always") for name in ALWAYS_IN_EVALUATION),
        *((name, "for") for name in IN_EVALUATION_IF_ASKED),
    ]
