"""Published numbers: merged, matched, averaged."""

from __future__ import annotations

from pathlib import Path

import pytest

from nerfreg.errors import NerfregError
from nerfreg.reports.paper import (
    PaperRow,
    published,
    read_paper,
    rows_over_scenes,
    vanilla_psnr,
    with_average,
)
from nerfreg.reports.records import Setting

HEAD = "table,dataset,views,scene,method,psnr,ssim,lpips,average\n"
LLFF = {"scene.format": "llff", "scene.split": "llff"}


@pytest.fixture
def paper(tmp_path: Path) -> list[PaperRow]:
    path = tmp_path / "paper.csv"
    path.write_text(
        HEAD
        + "main,llff,3,mean,vanilla,17.71,0.544,0.303,\n"
        # repeated: what is new in it is taken over
        + "ablation,llff,3,mean,vanilla,17.7,0.544,0.303,0.155\n"
        + "ablation,llff,3,mean,kl,18.5,,,\n"
        + "scenes,llff,3,fern,vanilla,16.0,0.5,0.4,0.1\n"
        + "scenes,llff,3,room,vanilla,20.0,0.7,0.2,0.2\n"
        + "scenes,llff,3,room,kl,21.0,0.7,0.2,\n"
        + "scenes,llff,6,fern,vanilla,23.0,0.7,0.2,\n"
        + "scenes,nerf_synthetic,8,chair,vanilla,25.25,0.901,0.076,\n"
    )
    return read_paper(path)


def test_rows_that_tables_repeat_are_merged(paper: list[PaperRow]) -> None:
    means = [row for row in paper if row.scene == "mean" and row.method == "vanilla"]
    assert means == [PaperRow("llff", 3, "mean", "vanilla", 17.71, 0.544, 0.303, 0.155)]
    assert len(paper) == 7


def test_scene_and_views_must_match(paper: list[PaperRow]) -> None:
    rows, notes = published(paper, Setting("fern", 3), LLFF)
    assert [row.psnr for row in rows] == [16.0] and notes == [] and vanilla_psnr(rows) == 16.0
    assert published(paper, Setting("fern", 9), LLFF) == ([], [])
    assert published(paper, Setting("horns", 3), LLFF) == ([], [])
    assert vanilla_psnr([]) is None


def test_so_must_the_protocol(paper: list[PaperRow]) -> None:
    chair = {"scene.format": "blender", "scene.split": "nerf_synthetic_8", "scene.factor": 2}
    assert len(published(paper, Setting("chair", 8), chair)[0]) == 1
    rows, notes = published(paper, Setting("chair (factor=8)", 8), {**chair, "scene.factor": 8})
    assert rows == [] and notes == [
        "The paper's rows are left out, because the runs have scene.factor=8."
    ]
    assert published(paper, Setting("fern", 3), {"scene.format": "transforms"})[0] == []


def test_the_average_where_it_was_not_published() -> None:
    # cube root of 10^-2 * sqrt(1 - 0.75) * 0.2 = 0.001
    row = PaperRow("d", 3, "s", "m", 20.0, 0.75, 0.2, None)
    assert with_average(row).average == pytest.approx(0.1)
    assert with_average(PaperRow("d", 3, "s", "m", 20.0, None, 0.2, None)).average is None
    assert with_average(PaperRow("d", 3, "s", "m", 20.0, 0.75, 0.2, 0.3)).average == 0.3


def test_means_over_some_scenes_are_of_their_own_rows(paper: list[PaperRow]) -> None:
    fern, room, chair = (
        [row for row in paper if (row.scene, row.views) == key]
        for key in (("fern", 3), ("room", 3), ("chair", 8))
    )
    # fern and room are all scenes with 3 views, so the published means count, which know kl
    assert [(row.method, row.psnr) for row in rows_over_scenes(paper, [fern, room])] == [
        ("vanilla", 17.71),
        ("kl", 18.5),
    ]
    # with one scene more they are some: vanilla was published on both of ours, kl on one
    more = [*paper, PaperRow("llff", 3, "horns", "vanilla", 1.0, 0.1, 0.1, 0.1)]
    (row,) = rows_over_scenes(more, [fern, room])
    assert (row.method, row.psnr, row.ssim, row.average) == (
        "vanilla",
        18.0,
        pytest.approx(0.6),
        pytest.approx(0.15),
    )
    (row,) = rows_over_scenes(paper, [fern, chair])
    assert row.psnr == pytest.approx(20.625)
    assert rows_over_scenes(paper, [fern, []]) == [] and rows_over_scenes([], [[], []]) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dataset,views\n", "no column scene, method, psnr, ssim, lpips, average"),
        ("", "no column dataset"),
        (HEAD + "t,llff,3,fern,vanilla,high,,,\n", "line 2: psnr=high is no number"),
        (HEAD + "t,llff,few,fern,vanilla,1,,,\n", "line 2: views=few is no whole number"),
    ],
)
def test_what_cannot_be_read(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "paper.csv").write_text(text)
    with pytest.raises(NerfregError, match=message):
        read_paper(tmp_path / "paper.csv")


def test_no_file_and_no_text(tmp_path: Path) -> None:
    with pytest.raises(NerfregError, match=r"none\.csv: cannot be read \(No such file"):
        read_paper(tmp_path / "none.csv")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\xff")
    with pytest.raises(NerfregError, match="cannot be read"):
        read_paper(tmp_path / "binary")
