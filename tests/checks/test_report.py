from __future__ import annotations

import json
import math

from nerfreg.checks.report import Report, Spot
from nerfreg.checks.table import COLUMNS, as_json, print_reports

WALL = Spot("wall_first", "float32", 48)
FOG = Spot("fog", "float64", 2)


def made() -> Report:
    report = Report("suspect", ("ray_bounds", "loss"), ("reg.suspect.power=2",))
    report.judge("value", FOG, [])
    report.judge("value", WALL, ["not finite"])
    report.judge("value", FOG, ["not finite"])
    report.measure("term", FOG, 1e-12, 1e-11)
    report.measure("term", FOG, 1e-13, 1e-11)
    report.inform("term", WALL, math.nan, 1e-3)
    return report


def test_states():
    report = made()
    assert [report.state(check) for check in ("value", "gradient", "error")] == [
        "FAIL",
        "n/a",
        "FAIL",
    ]
    assert report.verdict == "FAIL"
    assert Report("idle").verdict == "n/a"
    assert len(report.spots) == 2


def test_worst_error_is_kept_and_nan_is_the_worst():
    report = made()
    assert (report.worst["float64"].error, report.worst["float64"].exact) == (1e-12, True)
    report.inform("term", WALL, 0.5, 1e-3)
    assert math.isnan(report.worst["float32"].error)


def test_table_in_plain_text(capsys):
    print_reports([made()])
    lines = capsys.readouterr().out.splitlines()
    assert tuple(lines[0].split()) == COLUMNS
    assert lines[1].split() == [
        "suspect",
        "bounds",
        "loss",
        "2",
        "FAIL",
        "n/a",
        "~nan",
        "1.0e-12",
        "n/a",
        "n/a",
        "FAIL",
    ]
    assert max(map(len, lines[:2])) <= 100
    assert lines[2].startswith("~")
    assert lines[3:7] == [
        "",
        "suspect: value: not finite",
        "    nerfreg check suspect --case wall_first --dtype float32 --samples 48 reg.suspect.power=2",
        "    and 1 times more, in fog",
    ]


def test_table_shows_five_different_failures(capsys):
    report = Report("suspect")
    report.judge("value", WALL, [f"mistake {i}" for i in range(7)])
    print_reports([report])
    out = capsys.readouterr().out
    assert [f"mistake {i}" in out for i in range(7)] == [True] * 5 + [False] * 2
    assert "suspect: 2 other failures, in wall_first" in out


def test_json():
    [plugin] = json.loads(as_json([made()]))["plugins"]
    assert plugin["verdict"] == "FAIL"
    assert plugin["worst"]["float32"] == {
        "error": "nan",
        "exact": False,
        "case": "wall_first",
        "dtype": "float32",
        "samples": 48,
    }
    assert plugin["failures"][0] == {
        "case": "wall_first",
        "dtype": "float32",
        "samples": 48,
        "check": "value",
        "message": "not finite",
        "reproduce": "nerfreg check suspect --case wall_first --dtype float32 --samples 48 reg.suspect.power=2",
    }
