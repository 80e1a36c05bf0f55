"""Tables as files: what programs and papers read."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

from nerfreg.reports.collect import collect
from nerfreg.reports.comparison import comparisons
from nerfreg.reports.paper import PaperRow
from nerfreg.reports.records import Setting
from nerfreg.reports.table_files import latex, markdown, write_tables
from nerfreg.reports.tables import Column, Row, Table, TableCell
from nerfreg.reports.templates import latex_text
from nerfreg.reports.timing import cost_tables

TABLE = Table(
    "fern, 3 views",
    "fern-3",
    (Column("PSNR", "dB", ".2f", "up"), Column("LPIPS", "", ".3f", "down")),
    (
        Row(
            "depth_smoothness",
            (TableCell(22.214, 0.1, 3, best=True), TableCell(0.2, None, 1, second=True)),
            3,
        ),
        Row("a|b", (TableCell(None), TableCell(3.0, at_most=True)), 1),
        Row("c", (TableCell(None, text="not reached"), TableCell(0.1)), 1),
        Row("vanilla (paper)", (TableCell(17.79), TableCell(None)), paper=True),
    ),
    notes=("100 % of a_b <x>",),
)


def test_markdown() -> None:
    assert markdown([TABLE]) == (
        "Bold: best. Italic: second best. ±: standard deviation.\n"
        "\n"
        "## fern, 3 views\n"
        "\n"
        "| method | PSNR (dB) ↑ | LPIPS ↓ | seeds |\n"
        "| :-- | --: | --: | --: |\n"
        "| depth_smoothness | **22.21 ± 0.10** | *0.200* | 3 |\n"
        "| a\\|b | n/a | ≤ 3.000 | 1 |\n"
        "| c | not reached | 0.100 | 1 |\n"
        "| vanilla (paper) | 17.79 | n/a |  |\n"
        "\n"
        "- 100 % of a_b \\<x\\>\n"
    )


def test_latex() -> None:
    body = latex(TABLE).splitlines()
    assert body[0] == r"% \usepackage{booktabs}"
    assert body[body.index(r"\toprule") - 1] == r"\begin{tabular}{lrrr}"
    rows = body[body.index(r"\toprule") + 1 : body.index(r"\end{tabular}")]
    assert rows == [
        r"method & PSNR (dB) $\uparrow$ & LPIPS $\downarrow$ & seeds \\",
        r"\midrule",
        r"depth\_smoothness & \textbf{22.21} $\pm$ 0.10 & \underline{0.200} & 3 \\",
        r"a\textbar{}b & n/a & $\le$ 3.000 & 1 \\",
        r"c & not reached & 0.100 & 1 \\",
        r"\midrule",
        r"vanilla (paper) & 17.79 & n/a &  \\",
        r"\bottomrule",
    ]
    assert r"100 \% of a\_b \textless{}x\textgreater{}\par" in body
    assert latex_text("~^\\") == r"\textasciitilde{}\textasciicircum{}\textbackslash{}"


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_csv_of_methods_and_of_runs(write_run: Callable[..., Path], tmp_path: Path) -> None:
    for seed, psnr in enumerate((20.0, 22.0)):
        write_run(f"{seed}", seed=seed, evaluations=((1.0, 10.0), (100.0, psnr)))
    write_run("2", seed=2, evaluations=((1.0, 10.0),), complete=False)
    (write_run("3", seed=3, evaluations=(), complete=False) / "failed.json").write_text(
        '{"error": "a, b"}'
    )
    records = collect([tmp_path])
    paper = [PaperRow("llff", 3, "fern", "vanilla", 17.79, 0.509, 0.402, 0.2)]
    tables = [*comparisons(records, paper, psnr=22.0), *cost_tables(records)]
    write_tables(records, tables, tmp_path / "out")
    runs, published = read(tmp_path / "out" / "methods.csv")
    about = [runs[key] for key in ("scene", "views", "scored", "method", "source", "n")]
    assert about == ["fern", "3", "test", "vanilla", "runs", "2"]
    # 20 and 22: deviations of 1 from their mean, sqrt(2 / 1)
    assert (runs["psnr_mean"], runs["psnr_std"], runs["psnr_n"]) == ("21", "1.41421", "2")
    assert (runs["depth_rmse_mean"], runs["depth_rmse_n"]) == ("", "")
    assert (runs["psnr_to_reach"], runs["seconds_to_psnr_mean"], runs["reached"]) == (
        "22",
        "",
        "reached by 1 of 2",
    )
    assert (published["method"], published["source"], published["n"]) == ("vanilla", "paper", "")
    assert (published["psnr_mean"], published["train_seconds_mean"]) == ("17.79", "")
    lines = read(tmp_path / "out" / "runs.csv")
    assert [(line["seed"], line["state"], line["psnr"], line["failure"]) for line in lines] == [
        ("0", "complete", "20", ""), ("1", "complete", "22", ""),
        ("2", "incomplete", "10", ""), ("3", "failed", "", "a, b"),
    ]  # fmt: skip
    assert [line["seconds_to_psnr"] for line in lines] == ["", "100", "", ""]
    assert lines[0]["folder"] == (tmp_path / "0").as_posix() and lines[1]["overrides"] == "seed=1"


def test_the_same_runs_give_the_same_bytes(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a")
    write_run("b", ["+reg=kl"], config={"reg": {"kl": {"weight": 1.0}}})

    def write(name: str) -> dict[str, bytes]:
        records = collect([tmp_path / "b", tmp_path / "a"])
        paths = write_tables(
            records, [*comparisons(records), *cost_tables(records)], tmp_path / name
        )
        return {path.relative_to(tmp_path / name).as_posix(): path.read_bytes() for path in paths}

    first = write("out")
    assert first == write("again")
    assert [*first] == [
        "tables.md",
        "tables/fern-3.tex",
        "tables/cost-fern-3.tex",
        "methods.csv",
        "runs.csv",
    ]


def test_a_setting_names_its_files() -> None:
    assert Setting("my Fern (factor=8)", 3, True).name == "my-fern-factor-8-3-held-out"
