"""Tables of methods: means over seeds and scenes, marks, the paper's rows, notes."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from nerfreg.reports.collect import collect
from nerfreg.reports.comparison import comparisons
from nerfreg.reports.paper import PaperRow, with_average
from nerfreg.reports.records import without_repetitions
from nerfreg.reports.tables import Column, Table, TableCell

KL = {"reg": {"kl": {"weight": 1.0}}}
PAPER = [
    with_average(PaperRow("llff", 3, "fern", "vanilla", 17.79, 0.509, 0.402)),
    with_average(PaperRow("llff", 3, "fern", "combinerf", 22.21, 0.713, 0.194)),
]


def cell(table: Table, label: str, key: str) -> TableCell:
    (row,) = (row for row in table.rows if row.label == label)
    return row.cells[[column.key for column in table.columns].index(key)]


def test_a_scene(write_run: Callable[..., Path], tmp_path: Path) -> None:
    for seed, psnr in enumerate((20.0, 21.0, 25.0)):
        write_run(f"v{seed}", seed=seed, evaluations=((10.0, 15.0), (100.0, psnr)))
    write_run("k", ["+reg=kl"], ((10.0, 15.0), (100.0, 23.0)), config=KL, lpips=None)
    (table,) = comparisons(collect([tmp_path]))
    assert (table.title, table.name, table.counted) == ("fern, 3 views", "fern-3", "seeds")
    assert [(row.label, row.count) for row in table.rows] == [("vanilla", 3), ("kl", 1)]
    # 20, 21, 25: mean 22, squares 4 + 1 + 9 = 14 over 2
    vanilla = cell(table, "vanilla", "psnr")
    assert (vanilla.value, vanilla.spread, vanilla.count) == pytest.approx((22.0, math.sqrt(7), 3))
    assert vanilla.second and not vanilla.best
    assert cell(table, "kl", "psnr") == TableCell(23.0, None, 1, best=True)
    assert cell(table, "kl", "lpips") == TableCell(None)
    assert cell(table, "vanilla", "million_points_per_second").value == 2.0
    # no depth is known, no PSNR was asked for
    assert not {"depth_rmse", "seconds_to_psnr"} & {column.key for column in table.columns}


def test_what_plugins_measured_has_columns(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("v")
    for seed, degrees in enumerate((0.5, 1.5)):
        measured = {"poses.degrees": degrees, "poses.unknown": None}
        write_run(f"k{seed}", ["+reg=kl"], config=KL, seed=seed, metrics=measured)
    (table,) = comparisons(collect([tmp_path]))
    (column,) = (column for column in table.columns if column.key.startswith("metrics."))
    assert (column.name, column.better) == ("poses.degrees", None)
    found = cell(table, "kl", "metrics.poses.degrees")
    # 0.5 and 1.5: mean 1, squares 0.25 + 0.25 over 1
    assert (found.value, found.spread, found.count) == pytest.approx((1.0, math.sqrt(0.5), 2))
    assert cell(table, "vanilla", "metrics.poses.degrees") == TableCell(None)


def test_a_mean_of_fewer_runs_says_so(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a")
    write_run("b", seed=1, lpips=None)
    (table,) = comparisons(collect([tmp_path]))
    assert cell(table, "vanilla", "lpips") == TableCell(0.25, None, 1)
    assert "LPIPS of vanilla: from 1 of 2 runs." in table.notes


def test_published_rows_stand_below_and_say_which_psnr_is_timed(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    # from 12.79 to 22.79: 17.79 is halfway, at sqrt(1 * 100) seconds
    write_run("a", evaluations=((1.0, 12.79), (100.0, 22.79)))
    (table,) = comparisons(collect([tmp_path]), PAPER)
    assert [(row.label, row.paper) for row in table.rows] == [
        ("vanilla", False),
        ("vanilla (paper)", True),
        ("combinerf (paper)", True),
    ]
    assert table.target == 17.79 and table.columns[-1].heading == "to 17.79 dB (s) ↓"
    assert cell(table, "vanilla", "seconds_to_psnr").value == pytest.approx(10.0)
    assert cell(table, "vanilla (paper)", "train_seconds") == TableCell(None)
    # 22.79 is above what is published, which is not compared: no mark
    assert not any(cell.best or cell.second for row in table.rows for cell in row.cells)
    assert any("subset of the views" in note for note in table.notes)
    assert any(note.startswith("Averages that the paper does not give") for note in table.notes)


def test_held_out_views_have_a_table_of_their_own_without_published_rows(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a")
    write_run("b", scene={"held_out": [0], "views": 4})
    tables = comparisons(collect([tmp_path]), PAPER)
    assert [(table.title, len(table.rows)) for table in tables] == [
        ("fern, 3 views", 3),
        ("fern, 3 views, scored on held-out training views", 1),
    ]


@pytest.mark.parametrize(
    ("psnr", "shown"), [(15.0, "≤ 10.0 ± 0.0"), (25.0, "reached by 1 of 2"), (31.0, "not reached")]
)
def test_seconds_to_a_psnr_in_words(
    write_run: Callable[..., Path], tmp_path: Path, psnr: float, shown: str
) -> None:
    write_run("a", evaluations=((10.0, 15.0), (100.0, 20.0)))
    write_run("b", seed=1, evaluations=((10.0, 15.0), (100.0, 30.0)))
    (table,) = comparisons(collect([tmp_path]), psnr=psnr)
    assert cell(table, "vanilla", "seconds_to_psnr").shown(Column("", format=".1f")) == shown


def test_seconds_to_a_psnr_over_seeds(write_run: Callable[..., Path], tmp_path: Path) -> None:
    # 20 dB at the end, after 100 s; and a third of the way from 15 to 30 dB, 10 * 64^(1/3) = 40 s
    write_run("a", evaluations=((10.0, 15.0), (100.0, 20.0)))
    write_run("b", seed=1, evaluations=((10.0, 15.0), (640.0, 30.0)))
    (table,) = comparisons(collect([tmp_path]), psnr=20.0)
    found = cell(table, "vanilla", "seconds_to_psnr")
    assert (found.value, found.spread, found.count) == pytest.approx((70.0, math.sqrt(1800), 2))


def test_over_scenes(write_run: Callable[..., Path], tmp_path: Path) -> None:
    room = {"path": "data/room"}
    for seed in (0, 1):
        write_run(f"f{seed}", seed=seed, evaluations=((100.0, 20.0 + 2 * seed),))
    write_run("r", scene=room, evaluations=((100.0, 30.0),))
    write_run("k", ["+reg=kl"], config=KL)
    write_run("rk", ["+reg=kl"], config=KL, scene=room, complete=False)
    write_run("six", scene={"views": 6})
    *scenes, over = comparisons(collect([tmp_path]))
    assert [table.name for table in scenes] == ["fern-3", "fern-6", "room-3"]
    assert over.title == "Mean over 2 llff scenes, 3 views" and over.setting is None
    # (21 + 30) / 2, not the mean over runs, 24; one scene has one seed, so no deviation
    assert [(row.label, row.count) for row in over.rows] == [("vanilla", 3)]
    assert cell(over, "vanilla", "psnr") == TableCell(25.5, None, 3)
    assert "Left out, without a complete run on room, 3 views: kl." in over.notes


def test_over_scenes_beside_published_means(write_run: Callable[..., Path], tmp_path: Path) -> None:
    paper = [
        PaperRow("llff", 3, scene, "vanilla", psnr, 0.5, 0.5, 0.5)
        for scene, psnr in (("fern", 15.0), ("room", 20.0))
    ]
    paper = [*paper, PaperRow("llff", 3, "mean", "kl", 18.0, None, None, None)]
    write_run("f", evaluations=((1.0, 10.0), (100.0, 20.0)))  # 15 dB after 10 s
    write_run(
        "r", scene={"path": "data/room"}, evaluations=((1.0, 10.0), (100.0, 20.0))
    )  # 20 dB after 100 s
    over = comparisons(collect([tmp_path]), paper)[-1]
    assert [row.label for row in over.rows] == ["vanilla", "kl (paper)"]
    assert cell(over, "vanilla", "seconds_to_psnr").value == pytest.approx(55.0)
    assert "PSNR to reach: fern 15 dB, room 20 dB." in over.notes


def test_over_scenes_of_all_kinds(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("f")
    write_run("c", scene={"path": "data/chair", "format": "blender", "views": 8, "split": None})
    titles = [table.title for table in comparisons(collect([tmp_path]))]
    assert titles == ["chair, 8 views", "fern, 3 views", "Mean over all 2 scenes"]


def test_runs_that_do_not_count_are_told(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a")
    write_run("b", seed=1, evaluations=((12.0, 9.0),), complete=False)
    (write_run("c", ["+reg=kl"], config=KL) / "failed.json").write_text(
        '{"error": "out of memory"}'
    )
    write_run("d")
    records, notes = without_repetitions(collect([tmp_path]))
    (table,) = comparisons(records, notes=notes)
    assert [(row.label, row.count) for row in table.rows] == [("vanilla", 1), ("kl", 0)]
    assert cell(table, "kl", "psnr").shown(table.columns[0]) == "n/a"
    assert table.notes[:2] == (
        f"vanilla, seed 1, is not complete and not in the means: 12 s so far ({tmp_path / 'b'})",
        f"kl, seed 0, failed: out of memory ({tmp_path / 'c'})",
    )
    assert "was run more than once" in table.notes[2]
