"""The one parser: what it reads and refuses, and that options of benches are fields of sizes."""

from __future__ import annotations

from argparse import Namespace
from importlib import import_module
from pathlib import Path

import pytest

from nerfreg.checks.inputs import DTYPES as CHECKED_DTYPES
from nerfreg.cli.entry import _select
from nerfreg.cli.parser import make_parser, parsers_of
from nerfreg.cli.tools import DTYPES
from nerfreg.errors import NerfregError

TOOLS = {"-o", "--quick", "--help", "-h", "--debug"}


def read(*words: str) -> Namespace:
    parser, rest = _select(make_parser(), words)
    return parser.read(rest)


def test_options_and_overrides_stand_in_any_order() -> None:
    step = read("bench", "step", "+reg=kl", "--at", "0.5", "~x", "--steps", "7", "train.rays=3")
    assert step.overrides == ["+reg=kl", "~x", "train.rays=3"]
    assert (step.at, step.steps, step.warmup) == (0.5, 7, None)
    swept = read("train", "seed=0,1", "-m", "+reg=kl")
    assert (swept.overrides, swept.multirun) == (["seed=0,1", "+reg=kl"], True)
    assert read("scene", "--info", "searchpath", "a=1").info == "searchpath"


def test_defaults_of_prune_and_report() -> None:
    prune = read("prune", "+reg=kl")
    assert (prune.budget, prune.folds, prune.steps, prune.tolerance) == (3600.0, None, None, 0.1)
    assert (prune.stride, prune.name, prune.folder) == (2, None, None)
    report = read("report", "a", "b")
    assert (report.runs, Path(report.folder), report.paper, report.psnr, report.views) == (
        ["a", "b"], Path("report"), None, None, (),
    )  # fmt: skip


def test_values_are_typed() -> None:
    report = read("report", "-o", "x", "a", "--psnr", "-1.5", "--views", "v1,v2,")
    assert (report.folder, report.psnr, report.views) == (Path("x"), -1.5, ("v1", "v2"))
    prune = read(
        "prune", "--budget", "90", "scene=llff", "--folds", "3", "--stride", "1", "+reg=kl"
    )
    assert (prune.budget, prune.folds, prune.stride) == (90.0, 3, 1)
    assert prune.overrides == ["scene=llff", "+reg=kl"]
    overhead = read("bench", "overhead", "--only", "kl,lipschitz")
    assert (overhead.overrides, overhead.only) == ([], ("kl", "lipschitz"))
    render = read("bench", "render", "runs/a", "--views", "4")
    assert (render.run, render.views) == ("runs/a", 4)
    assert read("check", "kl", "--samples=2", "reg.kl.x=1").plugins == ["kl", "reg.kl.x=1"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("trian", "unknown verb 'trian'; did you mean 'train'?"),
        ("train --multrun", "train: unknown option '--multrun'; did you mean '--multirun'?"),
        ("evaluate", "evaluate needs the folder of a run: nerfreg evaluate RUN"),
        ("cite a b", "cite takes no further argument, got 'b'"),
        ("report", "report needs folders of runs: nerfreg report RUNS..."),
        ("report -o x", "report needs folders of runs"),
        ("report a -o", "-o needs a value: -o FOLDER, a folder to write to"),
        ("report a --paper -o x", "--paper needs a value: --paper FILE, a CSV file"),
        ("report a --pape", "report: unknown option '--pape'; did you mean '--paper'?"),
        ("report a --psnr high", "--psnr high: must be a number of decibels"),
        ("report a --psnr nan", "--psnr nan: must be a number of decibels"),
        ("report a -o pyproject", "-o pyproject: is a file; name a folder"),
        ("prune --budgt 3", "prune: unknown option '--budgt'; did you mean '--budget'?"),
        ("prune --budget -3", "--budget -3: must be a positive number"),
        ("prune --budget inf", "--budget inf: must be a positive number"),
        ("prune --folds x", "--folds x: must be a whole number, at least 1"),
        ("bench", "bench needs a name first; known: quadrature, losses"),
        ("bench --quick", "unknown bench '--quick'"),
        ("bench los", "unknown bench 'los'; did you mean 'losses'?"),
        ("bench losses x", "bench losses takes no further argument, got 'x'"),
        ("bench losses --steps 3", "bench losses: unknown option '--steps'"),
        ("bench step --quik", "bench step: unknown option '--quik'; did you mean '--quick'?"),
        ("bench step --at 1.5", "--at 1.5: must be a share of the budget, 0 to 1"),
        ("bench step --at nan", "--at nan: must be a share of the budget"),
        ("bench render", "bench render needs the folder of a run: nerfreg bench render RUN"),
        ("check --dtype float23", "--dtype float23: did you mean 'float32'?"),
        ("check --samples 0", "--samples 0: must be a whole number, at least 1"),
        ("check --case", "--case needs a value: --case NAME, only this case"),
        ("check --jason", "check: unknown option '--jason'; did you mean '--json'?"),
    ],
)
def test_mistakes_are_one_line(
    words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("pyproject").write_text("")
    with pytest.raises(NerfregError) as error:
        read(*words.split())
    assert str(error.value).startswith(message) and "\n" not in str(error.value)


def test_every_option_of_a_bench_is_a_field_of_its_sizes() -> None:
    for name, parser in parsers_of(parsers_of(make_parser())["bench"]).items():
        bench = import_module(f"nerfreg.bench.{name}")
        options = {*parser._option_string_actions} - TOOLS
        for sizes in (bench.FULL, bench.QUICK):
            assert {option.removeprefix("--") for option in options} <= {*vars(sizes)}, name


def test_precisions_are_those_of_the_checks() -> None:
    assert sorted(DTYPES) == sorted(CHECKED_DTYPES)
