"""Curves: which evaluations they go through, and their mean and spread over seeds."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from nerfreg.analysis.figures import Style, styles
from nerfreg.reports.figures import band, curve, draw_curves, draw_pareto, finals
from nerfreg.reports.paper import PaperRow, with_average
from nerfreg.reports.records import NamedRun, by_method
from nerfreg.runs.records import EvaluationRecord

Score = float | None


def score(
    seconds: float, psnr: Score, whole: bool = False, average: Score = None
) -> EvaluationRecord:
    views = 3 if whole else 2
    step = int(10 * seconds)
    return EvaluationRecord(step, seconds, psnr, average=average, views=views, whole=whole)


def run(
    *evaluations: EvaluationRecord, complete: bool = True, method: str = "vanilla", seed: int = 0
) -> NamedRun:
    final = evaluations[-1] if complete else None
    folder = Path(f"{method}-{seed}")
    return NamedRun(folder, "fern", 3, False, seed, evaluations, final, method=method)


def looks(runs: list[NamedRun]) -> dict[str, Style]:
    return {style.label: style for style in styles(list(by_method(runs)))}


def points(seconds: tuple[float, ...], values: tuple[float, ...]) -> np.ndarray:
    return np.array([seconds, values], dtype=float).T


def test_a_curve_leaves_out_the_final_score_which_is_of_other_views() -> None:
    scored = run(score(1.0, 10.0), score(10.0, 20.0), score(10.0, 25.0, whole=True))
    assert curve(scored, "psnr").tolist() == points((1.0, 10.0), (10.0, 20.0)).tolist()


def test_where_all_evaluations_are_of_all_views_the_curve_ends_at_the_final_one() -> None:
    scored = run(score(1.0, 10.0, whole=True), score(10.0, 25.0, whole=True))
    assert curve(scored, "psnr").tolist() == points((1.0, 10.0), (10.0, 25.0)).tolist()


def test_what_is_unknown_not_finite_or_before_training_is_no_point_of_a_curve() -> None:
    scored = run(
        score(0.0, 5.0), score(1.0, None), score(2.0, math.nan), score(3.0, 12.0), complete=False
    )
    assert curve(scored, "psnr").tolist() == points((3.0,), (12.0,)).tolist()
    assert curve(scored, "average").tolist() == points((), ()).tolist()


def test_seeds_meet_at_common_times_and_in_between_values_are_linear_in_log_time() -> None:
    # Seed 0 goes from 1 s to 100 s, seed 1 from 10 s to 1000 s: both have data from 10 s to 100 s.
    # At 10 s, halfway from 1 to 100 in log time, seed 0 is at (10 + 20) / 2 = 15; at 100 s seed 1,
    # halfway from 10 to 1000, is at (11 + 31) / 2 = 21.
    found = band([points((1.0, 100.0), (10.0, 20.0)), points((10.0, 1000.0), (11.0, 31.0))])
    assert found is not None
    assert found[0].tolist() == [10.0, 100.0]
    assert found[1].tolist() == pytest.approx([13.0, 20.5])
    assert found[2].tolist() == pytest.approx([11.0, 20.0])
    assert found[3].tolist() == pytest.approx([15.0, 21.0])


def test_a_band_has_the_times_of_all_seeds() -> None:
    # 100 s is in the middle of 10 s and 1000 s in log time: seed 0 has (0 + 4) / 2 = 2 there, and
    # seed 1 has 6.
    found = band(
        [points((10.0, 1000.0), (0.0, 4.0)), points((10.0, 100.0, 1000.0), (0.0, 6.0, 4.0))]
    )
    assert found is not None
    assert found[0].tolist() == [10.0, 100.0, 1000.0]
    assert found[1].tolist() == pytest.approx([0.0, 4.0, 4.0])


def test_one_seed_is_its_own_mean_and_has_no_width() -> None:
    found = band([points((1.0, 2.0, 4.0), (3.0, 5.0, 4.0))])
    assert found is not None
    assert found[1].tolist() == found[2].tolist() == found[3].tolist() == [3.0, 5.0, 4.0]


@pytest.mark.parametrize(
    "group",
    [
        [],
        [points((), ())],
        [points((1.0,), (2.0,))],
        [
            points((1.0, 2.0), (1.0, 2.0)),
            points((3.0, 4.0), (1.0, 2.0)),
        ],  # over before the other begins
        [points((1.0, 2.0), (1.0, 2.0)), points((2.0, 4.0), (1.0, 2.0))],  # meet in one point
    ],
)
def test_without_two_common_times_there_is_no_band(group: list[np.ndarray]) -> None:
    assert band(group) is None


def test_the_final_point_is_of_complete_runs_alone() -> None:
    runs = [
        run(score(90.0, 20.0, whole=True), seed=0),
        run(score(110.0, 23.0, whole=True), seed=1),
        run(score(50.0, 99.0), seed=2, complete=False),
    ]
    assert finals(runs, "psnr").tolist() == [[90.0, 20.0], [110.0, 23.0]]
    assert len(finals(runs, "average")) == 0


def test_a_figure_shows_complete_runs_and_those_being_written(tmp_path: Path) -> None:
    early, late = score(1.0, 10.0, average=0.3), score(10.0, 20.0, average=0.2)
    runs = [
        run(early, late, score(10.0, 25.0, whole=True, average=0.1)),
        run(early, late, method="kl", complete=False),
        run(method="unscored", complete=False),
    ]
    png, svg = draw_curves(runs, looks(runs), "fern, 3 views", tmp_path / "curves-fern-3")
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
        draw_curves(runs, looks(runs), "fern", tmp_path / name)[1].read_bytes() for name in "ab"
    ]
    assert files[0] == files[1]


def test_published_numbers_are_level_lines_with_names(tmp_path: Path) -> None:
    runs = [run(score(1.0, 10.0, average=0.3), score(10.0, 20.0, average=0.2))]
    paper = [
        # its average is computed
        with_average(PaperRow("llff", 3, "fern", "vanilla", 17.79, 0.509, 0.402)),
        PaperRow("llff", 3, "fern", "other", 30.0, None, None, None),
        PaperRow("llff", 3, "fern", "close", 30.1, None, None, None),
    ]
    _, svg = draw_curves(runs, looks(runs), "fern, 3 views", tmp_path / "curves", paper)
    text = svg.read_text()
    assert text.count("vanilla (paper)") == 2 and text.count("close, other (paper)") == 1
    # The axis reaches up to what was published, which no run has.
    assert ">30.0<" in text


def test_axes_reach_what_was_published_beside_many_methods(tmp_path: Path) -> None:
    runs = [
        run(
            score(1.0, 10.0, average=0.3),
            score(10.0, 20.0, average=0.2 + 0.001 * k),
            method=f"method_{k}",
        )
        for k in range(30)
    ]
    paper = [with_average(PaperRow("llff", 3, "fern", "other", 30.0, 0.999, 0.002))]
    text = draw_curves(runs, looks(runs), "fern, 3 views", tmp_path / "curves", paper)[
        1
    ].read_text()
    assert ">0.05<" in text and ">30.0<" in text


def test_without_runs_that_are_scored_nothing_published_is_drawn(tmp_path: Path) -> None:
    runs = [run(complete=False)]
    paper = [PaperRow("llff", 3, "fern", "vanilla", 17.79, 0.509, 0.402, None)]
    svg = draw_curves(runs, looks(runs), "fern", tmp_path / "curves", paper)[1]
    assert "(paper)" not in svg.read_text()


def test_the_front_is_drawn_where_higher_psnr_is_better(tmp_path: Path) -> None:
    runs = [
        run(score(100.0, 18.0, whole=True)),
        run(score(200.0, 17.0, whole=True), method="kl"),
        run(score(300.0, 21.0, whole=True), method="combinerf"),
    ]
    text = draw_pareto(runs, looks(runs), "fern, 3 views", tmp_path / "pareto")[1].read_text()
    assert "no data" in text  # no run has an average
    assert all(f">{method}<" in text for method in ("vanilla", "kl", "combinerf"))
    # the line has a corner between vanilla and combinerf, and does not pass through kl
    (front,) = re.findall(r'<path d="([^"]*)"[^>]*style="[^"]*stroke-dasharray: 3,2', text)
    assert front.count("L") == 2
