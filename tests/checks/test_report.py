from __future__ import annotations

import json
import math

import torch
from omegaconf import OmegaConf

from nerfreg.checks.report import Report, Spot, UnpreparedError
from nerfreg.checks.subject import Subject
from nerfreg.checks.tables import COLUMNS, print_json, print_reports

WALL = Spot("wall_first", "float32", 48)
REPRODUCTION = (
    "nerfreg check suspect --case wall_first --dtype float32 --samples 48 reg.suspect.power=2"
)
FOG = Spot("fog", "float64", 2)


def suspect(*hook_points: str) -> Subject:
    return Subject("suspect", hook_points, OmegaConf.create(), ("reg.suspect.power=2",))


def made() -> Report:
    report = Report(suspect("ray_bounds", "loss"))
    with report.at(FOG, "value"):
        report.judge("value", [])
    with report.at(WALL, "value"):
        report.judge("value", ["not finite"])
        report.compare_own("term", torch.tensor(math.nan), torch.tensor(1.0))
    with report.at(FOG, "value"):
        report.judge("value", ["not finite"])
        report.compare({"term": torch.tensor(1 + 2**-40, dtype=torch.float64)}, {"term": 1.0})
        report.compare({"term": torch.tensor(1 + 2**-43, dtype=torch.float64)}, {"term": 1.0})
    return report


def test_states():
    report = made()
    assert [report.state(check) for check in ("value", "gradient", "error")] == [
        "FAIL",
        "n/a",
        "FAIL",
    ]
    assert report.verdict == "FAIL"
    assert Report(suspect()).verdict == "n/a"
    assert len(report.spots) == 2


def test_worst_error_is_kept_and_nan_is_the_worst():
    report = made()
    assert (report.worst["float64"].error, report.worst["float64"].exact) == (2**-40, True)
    with report.at(WALL, "value"):
        report.compare_own("term", torch.tensor(1.5), torch.tensor(1.0))
    assert math.isnan(report.worst["float32"].error)


def test_table_in_plain_text(capsys):
    print_reports([made()])
    lines = capsys.readouterr().out.splitlines()
    assert tuple(lines[0].split()) == tuple(COLUMNS)
    assert lines[1].split() == [
        "suspect",
        "bounds",
        "loss",
        "2",
        "FAIL",
        "n/a",
        "~nan",
        "9.1e-13",
        "n/a",
        "n/a",
        "FAIL",
    ]
    assert max(map(len, lines[:2])) <= 100
    assert lines[2].startswith("~")
    assert max(map(len, lines[3:-2])) <= 100
    assert lines[3:5] == ["", "suspect:"]
    assert [line.split()[:3] for line in lines[5:9]] == [
        ["value", "FAIL", "3"],
        ["gradient", "skipped", "no"],
        ["error", "FAIL", "3"],
        ["invariance", "skipped", "no"],
    ]
    at = lines.index("suspect: value: not finite")
    assert lines[at + 1 : at + 3] == [f"    {REPRODUCTION}", "    and 1 times more, in fog"]


def test_table_shows_five_different_failures(capsys):
    report = Report(suspect())
    report.spot = WALL
    report.judge("value", [f"mistake {i}" for i in range(7)])
    print_reports([report])
    out = capsys.readouterr().out
    assert [f"mistake {i}" in out for i in range(7)] == [True] * 5 + [False] * 2
    assert "suspect: value: 2 other failures, in wall_first" in out


def test_a_check_without_files_is_skipped_and_says_why(capsys):
    report = Report(suspect("prepare", "loss"))
    with report.at(FOG, "value"):
        raise UnpreparedError("nerfreg_prepare: no file depth/0.png")
    assert report.failures == []
    print_reports([report])
    out = capsys.readouterr().out
    assert "  value       skipped        nerfreg_prepare: no file depth/0.png" in out
    print_json([report])
    [plugin] = json.loads(capsys.readouterr().out)["plugins"]
    assert plugin["skipped"]["value"] == "nerfreg_prepare: no file depth/0.png"
    assert plugin["skipped"]["cost"] == "no hook that is called in a step"


def test_failures_of_one_check_do_not_hide_those_of_another(capsys):
    report = Report(suspect())
    report.spot = WALL
    report.judge("value", [f"mistake {i}" for i in range(7)])
    report.judge("cost", ["too slow"])
    print_reports([report])
    assert "suspect: cost: too slow" in capsys.readouterr().out


def test_json(capsys):
    print_json([made()])
    [plugin] = json.loads(capsys.readouterr().out)["plugins"]
    assert plugin["times_checked"]["value"] == 3
    assert "value" not in plugin["skipped"]
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
        "reproduce": REPRODUCTION,
    }
