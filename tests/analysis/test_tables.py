from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import pytest
from rich.console import Console

from nerfreg.analysis.tables import (
    build_table,
    numbers,
    publish_points,
    publish_record,
    select,
    text,
)


@dataclass(frozen=True)
class Reading:
    name: str
    value: float
    count: int


READINGS = [Reading("a", 1 / 3, 1), Reading("b", 2.0, 1), Reading("a", 1e-9, 2)]


def lines(table: object) -> list[str]:
    console = Console(width=80)
    with console.capture() as captured:
        console.print(table)
    return [line.rstrip() for line in captured.get().splitlines()]


def test_words_are_on_the_left_and_numbers_on_the_right() -> None:
    columns = [*text("name"), *numbers("value")]
    title, _, header, _, first, second, _, caption = lines(
        build_table("Title", "How to read it", columns, [("a", "1.5"), ("longer", "12.25")])
    )
    assert (title, caption) == ("Title", "How to read it")
    assert header.split() == ["name", "value"]
    assert first == " a        1.5"
    assert second == " longer 12.25"


def test_points_are_selected_by_all_values() -> None:
    assert select(READINGS, name="a") == [READINGS[0], READINGS[2]]
    assert select(READINGS, name="a", count=2) == [READINGS[2]]
    assert select(READINGS, name="c") == []


def test_points_become_a_table_a_file_and_a_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn = [tmp_path / "readings.png"]
    table = build_table("Read", "", text("name"), [("a",)])
    files = publish_points(tmp_path / "readings", READINGS, table, lambda points, stem: drawn)
    assert files == [tmp_path / "readings.csv", *drawn]
    assert capsys.readouterr().out.startswith("Read")
    with files[0].open(newline="") as file:
        rows = list(csv.reader(file))
    # Six digits of what is not whole.
    assert rows == [
        ["name", "value", "count"],
        ["a", "0.333333", "1"],
        ["b", "2", "1"],
        ["a", "1e-09", "2"],
    ]


def test_a_record_is_printed_flat_and_written_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = {"peak_mb": 12.3456, "reg": ["kl", "entropy"], "parts": {"rest": 1.0}}
    publish_record(tmp_path / "record.json", "The record", record)
    out = capsys.readouterr().out
    assert "peak mb" in out and "12.35" in out and "kl, entropy" in out and "parts" not in out
    assert json.loads((tmp_path / "record.json").read_text()) == record
