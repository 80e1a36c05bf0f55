"""Curves: which evaluations they go through, and what is mean and spread over seeds at common times."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from nerfreg.reports.curves import (
    Point,
    Series,
    band,
    draw_curves,
    final_point,
    legend_columns,
    series,
)
from nerfreg.reports.paper import PaperRow
from nerfreg.reports.records import Evaluation, RunRecord
from nerfreg.reports.style import method_styles

Score = float | None


def score(seconds: float, psnr: Score, whole: bool = False, average: Score = None) -> Evaluation:
    return Evaluation(
        int(10 * seconds), seconds, psnr, None, None, average, None, 3 if whole else 2, whole
    )


def run(
    *evaluations: Evaluation, complete: bool = True, method: str = "vanilla", seed: int = 0
) -> RunRecord:
    final = evaluations[-1] if complete else None
    folder = Path(f"{method}-{seed}")
    return RunRecord(folder, method, "fern", 3, seed, False, evaluations, final, None, None, {}, ())


def test_a_curve_leaves_out_the_final_score_which_is_of_other_views() -> None:
    scored = run(score(1.0, 10.0), score(10.0, 20.0), score(10.0, 25.0, whole=True))
    assert series(scored, "psnr") == Series((1.0, 10.0), (10.0, 20.0))


def test_where_all_evaluations_are_of_all_views_the_curve_ends_at_the_final_one() -> None:
    scored = run(score(1.0, 10.0, whole=True), score(10.0, 25.0, whole=True))
    assert series(scored, "psnr") == Series((1.0, 10.0), (10.0, 25.0))


def test_what_is_unknown_not_finite_or_before_training_is_no_point_of_a_curve() -> None:
    scored = run(
        score(0.0, 5.0), score(1.0, None), score(2.0, math.nan), score(3.0, 12.0), complete=False
    )
    assert series(scored, "psnr") == Series((3.0,), (12.0,))
    assert series(scored, "average") == Series((), ())


def test_seeds_meet_at_common_times_and_in_between_values_are_linear_in_log_time() -> None:
    # seed 0 goes from 1 s to 100 s, seed 1 from 10 s to 1000 s: both have data from 10 s to 100 s.
    # At 10 s, half way from 1 to 100 in log time, seed 0 is at (10 + 20) / 2 = 15; at 100 s seed 1, half way
    # from 10 to 1000, is at (11 + 31) / 2 = 21.
    found = band([Series((1.0, 100.0), (10.0, 20.0)), Series((10.0, 1000.0), (11.0, 31.0))])
    assert found is not None
    assert found.seconds.tolist() == [10.0, 100.0]
    assert found.mean.tolist() == pytest.approx([13.0, 20.5])
    assert found.low.tolist() == pytest.approx([11.0, 20.0])
    assert found.high.tolist() == pytest.approx([15.0, 21.0])


def test_a_band_has_the_times_of_all_seeds() -> None:
    # 100 s is in the middle of 10 s and 1000 s in log time: seed 0 has (0 + 4) / 2 = 2 there, seed 1 has 6.
    found = band(
        [Series((10.0, 1000.0), (0.0, 4.0)), Series((10.0, 100.0, 1000.0), (0.0, 6.0, 4.0))]
    )
    assert found is not None
    assert found.seconds.tolist() == [10.0, 100.0, 1000.0]
    assert found.mean.tolist() == pytest.approx([0.0, 4.0, 4.0])


def test_one_seed_is_its_own_mean_and_has_no_width() -> None:
    found = band([Series((1.0, 2.0, 4.0), (3.0, 5.0, 4.0))])
    assert found is not None
    assert found.mean.tolist() == found.low.tolist() == found.high.tolist() == [3.0, 5.0, 4.0]


@pytest.mark.parametrize(
    "group",
    [
        [],
        [Series((), ())],
        [Series((1.0,), (2.0,))],
        [
            Series((1.0, 2.0), (1.0, 2.0)),
            Series((3.0, 4.0), (1.0, 2.0)),
        ],  # over before the other begins
        [Series((1.0, 2.0), (1.0, 2.0)), Series((2.0, 4.0), (1.0, 2.0))],  # meet in one point
    ],
)
def test_without_two_common_times_there_is_no_band(group: list[Series]) -> None:
    assert band(group) is None


def test_the_final_point_is_of_complete_runs_alone() -> None:
    runs = [
        run(score(90.0, 20.0, whole=True), seed=0),
        run(score(110.0, 23.0, whole=True), seed=1),
        run(score(50.0, 99.0), seed=2, complete=False),
    ]
    assert final_point(runs, "psnr") == Point(seconds=100.0, value=21.5, low=20.0, high=23.0)
    assert final_point(runs, "average") is None


def test_a_figure_shows_complete_runs_and_those_being_written(tmp_path: Path) -> None:
    early, late = score(1.0, 10.0, average=0.3), score(10.0, 20.0, average=0.2)
    runs = [
        run(early, late, score(10.0, 25.0, whole=True, average=0.1)),
        run(early, late, method="kl", complete=False),
        run(method="unscored", complete=False),
    ]
    png, svg = draw_curves(runs, method_styles(runs), "fern, 3 views", tmp_path / "curves-fern-3")
    assert png.read_bytes().startswith(b"\x89PNG") and svg.name == "curves-fern-3.svg"
    text = svg.read_text()
    assert (
        "kl (not complete)" in text
        and ">vanilla<" in text
        and "PSNR [dB]" in text
        and ">10 s<" in text
    )
    # dots are written as a dash pattern: kl in two panels and in the legend, and unscored there
    assert text.count("stroke-dasharray: 1") == 4


def test_the_same_runs_give_the_same_bytes(tmp_path: Path) -> None:
    runs = [run(score(1.0, 10.0), score(10.0, 20.0), score(10.0, 25.0, whole=True))]
    files = [
        draw_curves(runs, method_styles(runs), "fern", tmp_path / name)[1].read_bytes()
        for name in "ab"
    ]
    assert files[0] == files[1]


def test_long_names_have_fewer_columns() -> None:
    # 6.9 inches are 497 points; a name of 20 characters takes about 130 of them, one of 80 more than half
    assert legend_columns(["x" * 20] * 5) == 3
    assert legend_columns(["x" * 20, "x" * 80]) == 1
    assert legend_columns([]) == 3


def test_published_numbers_are_level_lines_with_names(tmp_path: Path) -> None:
    runs = [run(score(1.0, 10.0, average=0.3), score(10.0, 20.0, average=0.2))]
    paper = [
        PaperRow(
            "llff", 3, "fern", "vanilla", 17.79, 0.509, 0.402, None
        ),  # its average is computed
        PaperRow("llff", 3, "fern", "other", 30.0, None, None, None),
        PaperRow("llff", 3, "fern", "close", 30.1, None, None, None),
    ]
    _, svg = draw_curves(runs, method_styles(runs), "fern, 3 views", tmp_path / "curves", paper)
    text = svg.read_text()
    assert text.count("vanilla (paper)") == 2 and text.count("close, other (paper)") == 1
    # The axis reaches up to what was published, which no run has.
    assert ">30.0<" in text


def test_axes_reach_what_was_published_where_names_of_methods_have_set_them(tmp_path: Path) -> None:
    runs = [
        run(
            score(1.0, 10.0, average=0.3),
            score(10.0, 20.0, average=0.2 + 0.001 * k),
            method=f"method_{k}",
        )
        for k in range(30)
    ]
    styles = method_styles(runs)
    assert any(style.faint for style in styles.values())
    paper = [PaperRow("llff", 3, "fern", "other", 30.0, 0.999, 0.002, None)]
    text = draw_curves(runs, styles, "fern, 3 views", tmp_path / "curves", paper)[1].read_text()
    assert ">0.05<" in text and ">30.0<" in text


def test_without_runs_that_are_scored_nothing_published_is_drawn(tmp_path: Path) -> None:
    runs = [run(complete=False)]
    paper = [PaperRow("llff", 3, "fern", "vanilla", 17.79, 0.509, 0.402, None)]
    assert (
        "(paper)"
        not in draw_curves(runs, method_styles(runs), "fern", tmp_path / "curves", paper)[
            1
        ].read_text()
    )
