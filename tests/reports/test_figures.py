"""Which figures there are for which runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from nerfreg.reports.costs import draw_costs
from nerfreg.reports.figures import draw, plots
from nerfreg.reports.grouping import Setting
from nerfreg.reports.records import Evaluation, RunRecord
from nerfreg.reports.timing import Cost


def run(method: str, scene: str = "fern", complete: bool = True, scored: bool = True) -> RunRecord:
    early = Evaluation(100, 10.0, 15.0, None, None, 0.2, None, 2, False)
    final = Evaluation(1000, 100.0, 18.0, None, None, 0.1, None, 3, True) if complete else None
    evaluations = (early, *([final] if final else [])) if scored else ()
    settings = {} if method == "vanilla" else {f"reg.{method}.weight": 1.0}
    return RunRecord(
        Path(scene, method),
        method,
        scene,
        3,
        0,
        False,
        evaluations,
        final,
        None,
        None,
        settings,
        (),
    )


@pytest.mark.parametrize(
    ("runs", "names"),
    [
        ([], []),
        ([run("vanilla")], ["curves-fern-3"]),
        ([run("vanilla"), run("kl")], ["curves-fern-3", "pareto-fern-3", "cost-fern-3"]),
        ([run("vanilla"), run("kl", complete=False)], ["curves-fern-3"]),  # one point is no front
        (
            [run("kl"), run("entropy")],
            ["curves-fern-3", "pareto-fern-3"],
        ),  # nothing to compare costs with
        ([run("vanilla", complete=False, scored=False)], []),
        ([run("vanilla"), run("kl", "chair")], ["curves-chair-3", "curves-fern-3"]),
    ],
)
def test_figures_are_of_what_there_is(runs: list[RunRecord], names: list[str]) -> None:
    assert [plot.name for plot in plots(runs)] == names


def test_a_figure_is_a_png_and_an_svg(tmp_path: Path) -> None:
    files = draw(plots([run("vanilla"), run("kl")]), tmp_path)
    stems = ("curves-fern-3", "pareto-fern-3", "cost-fern-3")
    assert [path.name for path in files] == [
        f"{stem}{suffix}" for stem in stems for suffix in (".png", ".svg")
    ]
    assert all(path.is_file() for path in files)


def test_many_methods_with_long_names_still_fit(tmp_path: Path) -> None:
    # matplotlib warns, and warnings are errors here, where names leave no room for the axes
    runs = [
        run("vanilla"),
        *(
            run(f"kl, a.very.long.key.of.a.setting={index}, and.another.one=true")
            for index in range(24)
        ),
    ]
    assert len(draw(plots(runs), tmp_path)) == 6


def test_costs_are_printed_beside_their_bars_cheapest_first(tmp_path: Path) -> None:
    fern = Setting("fern", 3, False)
    costs = [
        Cost(fern, "combinerf", 2, 0.0575, 1.15, 3),
        Cost(fern, "vanilla", 2, 0.05, 1.0, 3),
        Cost(fern, "other", 2, 0.07, None, 1),
    ]
    text = draw_costs(costs, "fern, 3 views", tmp_path / "cost")[1].read_text()
    assert "1.15  (57.5 ms)" in text and "1.00  (50 ms)" in text and "other" not in text
    assert text.index(">vanilla<") < text.index(">combinerf<")
