"""Which figures there are for which runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from nerfreg.reports.figures import draw_figures
from nerfreg.reports.records import NamedRun
from nerfreg.runs.records import EvaluationRecord


def run(method: str, scene: str = "fern", complete: bool = True, scored: bool = True) -> NamedRun:
    early = EvaluationRecord(100, 10.0, 15.0, None, None, 0.2, None, 2, False)
    final = (
        EvaluationRecord(1000, 100.0, 18.0, None, None, 0.1, None, 3, True) if complete else None
    )
    evaluations = (early, *([final] if final else [])) if scored else ()
    settings = {} if method == "vanilla" else {f"reg.{method}.weight": 1.0}
    folder = Path(scene, method)
    return NamedRun(folder, scene, 3, False, 0, evaluations, final, settings, method=method)


@pytest.mark.parametrize(
    ("runs", "names"),
    [
        ([], []),
        ([run("vanilla")], ["curves-fern-3"]),
        ([run("vanilla"), run("kl")], ["curves-fern-3", "pareto-fern-3"]),
        ([run("vanilla"), run("kl", complete=False)], ["curves-fern-3"]),  # one point is no front
        ([run("vanilla", complete=False, scored=False)], []),
        ([run("vanilla"), run("kl", "chair")], ["curves-chair-3", "curves-fern-3"]),
    ],
)
def test_figures_are_of_what_there_is(
    runs: list[NamedRun], names: list[str], tmp_path: Path
) -> None:
    assert [path.stem for path in draw_figures(runs, [], tmp_path)[::2]] == names


def test_a_figure_is_a_png_and_an_svg(tmp_path: Path) -> None:
    files = draw_figures([run("vanilla"), run("kl")], [], tmp_path)
    stems = ("curves-fern-3", "pareto-fern-3")
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
    assert len(draw_figures(runs, [], tmp_path)) == 4
