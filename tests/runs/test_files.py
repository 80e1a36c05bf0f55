from __future__ import annotations

import json
import math

import pytest

from nerfreg.errors import NerfregError
from nerfreg.runs.files import append_metrics, write_results


def strict(text: str) -> dict:
    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_metrics_are_one_line_each_and_kept(tmp_path):
    append_metrics(tmp_path / "run", {"step": 1, "psnr": 10.5})
    append_metrics(tmp_path / "run", {"step": 2, "psnr": 11.0})
    lines = (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()
    assert [strict(line) for line in lines] == [
        {"step": 1, "psnr": 10.5},
        {"step": 2, "psnr": 11.0},
    ]


def test_what_is_not_a_number_is_null_at_any_depth(tmp_path):
    record = {
        "psnr": math.inf,
        "lpips": None,
        "terms": {"kl": math.nan, "color": 0.5},
        "views": (1, -math.inf),
    }
    append_metrics(tmp_path, record)
    write_results(tmp_path, record)
    expected = {
        "psnr": None,
        "lpips": None,
        "terms": {"kl": None, "color": 0.5},
        "views": [1, None],
    }
    assert strict((tmp_path / "metrics.jsonl").read_text()) == expected
    assert strict((tmp_path / "results.json").read_text()) == expected


def test_results_are_replaced_as_a_whole(tmp_path):
    write_results(tmp_path, {"step": 1, "old": True})
    write_results(tmp_path, {"step": 2})
    assert strict((tmp_path / "results.json").read_text()) == {"step": 2}
    assert [p.name for p in tmp_path.iterdir()] == ["results.json"]


def test_results_that_cannot_be_written_leave_the_old_ones(tmp_path):
    write_results(tmp_path, {"step": 1})
    with pytest.raises(TypeError):
        write_results(tmp_path, {"step": object()})
    assert strict((tmp_path / "results.json").read_text()) == {"step": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["results.json"]


@pytest.mark.parametrize("write", [append_metrics, write_results])
def test_a_folder_that_is_a_file_is_an_error_by_name(tmp_path, write):
    (tmp_path / "run").touch()
    with pytest.raises(NerfregError, match=r"run/(metrics|results)\.json"):
        write(tmp_path / "run", {"step": 1})
