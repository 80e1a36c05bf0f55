"""Pictures: cut apart, compared at one scale, with the detail where methods differ."""

from __future__ import annotations

import json
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from nerfreg.errors import NerfregError
from nerfreg.reports.pictures import (
    SCALES,
    Crop,
    Rendered,
    compare,
    largest_difference,
    read_strip,
    shared_scale,
    telling_views,
)
from nerfreg.reports.records import NamedRun
from nerfreg.reports.sheet import draw_sheet
from nerfreg.runs.records import EvaluationRecord

HEIGHT, WIDTH = 8, 12


def plain(value: int, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    return np.full((height, width, 3), value, np.uint8)


def run(
    folder: Path,
    method: str,
    scores: dict[str, float],
    color: np.ndarray | None = None,
    seed: int = 0,
) -> NamedRun:
    """A run whose pictures have a colour (100), depth 30, photograph 110, and an unused error."""
    color = plain(100) if color is None else color
    depth, photograph, wrong = (plain(value, *color.shape[:2]) for value in (30, 110, 200))
    (folder / "renders").mkdir(parents=True)
    for view in scores:
        iio.imwrite(
            folder / "renders" / f"{view}.png",
            np.concatenate([color, depth, photograph, wrong], axis=1),
        )
    views = {view: {"psnr": score} for view, score in scores.items()}
    (folder / "results.json").write_text(json.dumps({"test_views": views}))
    final = EvaluationRecord(100, 60.0, 20.0, views=3, whole=True)
    return NamedRun(folder, "fern", 3, False, seed, (final,), final, method=method)


def test_a_strip_is_cut_into_colour_depth_and_photograph(tmp_path: Path) -> None:
    run(tmp_path / "run", "vanilla", {"a": 20.0})
    parts = read_strip(tmp_path / "run" / "renders" / "a.png")
    assert [part.shape for part in parts] == [(HEIGHT, WIDTH, 3)] * 3
    assert [int(part[0, 0, 0]) for part in parts] == [100, 30, 110]


def rendered(color: np.ndarray, photograph: np.ndarray) -> Rendered:
    return Rendered("vanilla", Path(), color, color, photograph)


@pytest.mark.parametrize("image", [np.zeros((4, 10, 3), np.uint8), np.zeros((4, 8), np.uint8)])
def test_what_is_no_strip_is_refused_by_name(tmp_path: Path, image: np.ndarray) -> None:
    iio.imwrite(tmp_path / "a.png", image)
    with pytest.raises(NerfregError, match=r"a\.png: .* is no strip"):
        read_strip(tmp_path / "a.png")


def test_a_broken_file_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n, and nothing more")
    with pytest.raises(NerfregError, match=r"a\.png: cannot be read"):
        read_strip(tmp_path / "a.png")


def test_the_error_is_the_mean_absolute_difference_of_the_channels() -> None:
    color, photograph = plain(0, 1, 2), plain(0, 1, 2)
    color[0, 1] = (255, 51, 0)
    photograph[0, 1] = (0, 102, 0)
    # (255 + 51 + 0) / 3 / 255 = 0.4; bytes must not wrap around where the photograph is brighter
    assert rendered(color, photograph).error.tolist() == [[0.0, pytest.approx(0.4)]]


def test_psnr_by_hand() -> None:
    # an error of 51 / 255 = 0.2 everywhere: -10 log10(0.04) = 13.979 dB
    assert rendered(plain(151), plain(100)).psnr == pytest.approx(13.9794, abs=1e-4)
    assert 50 < rendered(plain(100), plain(100)).psnr < 60


def test_the_detail_is_where_methods_differ_and_not_where_all_are_wrong() -> None:
    errors = np.zeros((2, 6, 9))
    errors[:, 0:2, 0:2] = 1.0  # both
    errors[1, 3:5, 6:8] = 0.5  # the second alone
    assert largest_difference(errors, 2) == Crop(3, 6, 2)
    assert largest_difference(errors[:1], 2) == Crop(0, 0, 2)


def test_the_detail_may_touch_the_border_and_be_the_whole_picture() -> None:
    errors = np.zeros((1, 4, 5))
    errors[0, 3, 4] = 1.0
    assert largest_difference(errors, 2) == Crop(2, 3, 2)
    assert largest_difference(errors, 4).side == 4


def test_of_several_runs_a_crop_covers_the_same_pixels() -> None:
    image = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3)
    assert Crop(1, 2, 2).of(image)[:, :, 0].tolist() == [[21, 24], [36, 39]]


@pytest.mark.parametrize(
    ("bright", "scale"), [(0.0, 0.1), (0.1, 0.1), (0.11, 0.2), (0.5, 0.5), (0.9, 1.0), (1.0, 1.0)]
)
def test_one_scale_holds_nearly_all_errors(bright: float, scale: float) -> None:
    errors = np.zeros((2, 10, 10))
    errors[1] = bright
    assert shared_scale(errors) == scale and scale in SCALES


def test_one_bright_pixel_in_a_hundred_does_not_darken_the_others() -> None:
    errors = np.full((1, 20, 20), 0.05)
    errors[0, 0, :3] = 1.0
    assert shared_scale(errors) == 0.1


def test_the_view_of_median_psnr_and_the_one_where_methods_differ_most() -> None:
    vanilla = {"a": 10.0, "b": 20.0, "c": 30.0, "d": 5.0, "only-here": 50.0}
    ours = {"a": 11.0, "b": 21.0, "c": 36.0, "d": 6.0}
    # sums a 21, b 41, c 66, d 11: of four the lower middle is a; differences a 1, b 1, c 6, d 1
    assert telling_views([vanilla, ours]) == ["a", "c"]


def test_one_view_if_it_is_both_or_if_there_is_one_method() -> None:
    assert telling_views([{"a": 1.0}, {"a": 2.0}]) == ["a"]
    assert telling_views([{"a": 1.0, "b": 5.0, "c": 3.0}]) == ["c"]
    assert telling_views([{"a": 1.0}, {"b": 2.0}]) == []
    assert telling_views([]) == []


def test_methods_are_compared_on_the_view_asked_for(tmp_path: Path) -> None:
    records = [
        run(tmp_path / "v1", "vanilla", {"a": 20.0, "b": 21.0}, plain(0), seed=1),
        run(tmp_path / "v0", "vanilla", {"a": 20.0, "b": 21.0}),
        run(tmp_path / "ours", "ours", {"b": 21.0}, plain(161)),
        run(tmp_path / "none", "unrendered", {}),
    ]
    (found,), notes = compare(records, ["b"])
    assert [shown.method for shown in found.methods] == ["vanilla", "ours"]
    assert found.methods[0].folder == tmp_path / "v0", "the smallest seed stands for a method"
    # errors of 10 / 255 and 51 / 255, recomputed: what the strip has in its last panel is not used
    assert [float(shown.error.max()) for shown in found.methods] == pytest.approx([10 / 255, 0.2])
    assert found.scale == 0.2 and found.crop.side == 2
    assert notes == ["fern, 3 views: no pictures of unrendered"]


def test_a_view_that_nobody_has_is_an_error_that_names_those_there_are(tmp_path: Path) -> None:
    records = [run(tmp_path / "v", "vanilla", {"a": 20.0})]
    with pytest.raises(
        NerfregError, match=r"--views c: no run has a picture of it; views with pictures: a"
    ):
        compare(records, ["a", "c"])


def test_pictures_of_another_size_are_left_out_with_a_note(tmp_path: Path) -> None:
    records = [
        run(tmp_path / "v", "vanilla", {"a": 20.0}),
        run(tmp_path / "half", "half", {"a": 20.0}, plain(100, HEIGHT // 2, WIDTH // 2)),
    ]
    (found,), notes = compare(records)
    assert [shown.method for shown in found.methods] == ["vanilla"]
    assert "left out, (4, 6) pixels instead of (8, 12)" in notes[0]


def test_without_pictures_there_is_nothing_to_compare(tmp_path: Path) -> None:
    compared, notes = compare([run(tmp_path / "none", "vanilla", {})])
    assert compared == [] and notes == ["fern, 3 views: no pictures of vanilla"]


def test_a_sheet_shows_every_pixel_of_every_method_in_its_row(tmp_path: Path) -> None:
    # Flat colours, so that the sheet can be read back: blue for one method, green for the other.
    blue, green = plain(0, 60, 90), plain(0, 60, 90)
    blue[..., 2], green[..., 1] = 255, 255
    records = [
        run(tmp_path / "v", "vanilla", {"a": 20.0}, blue),
        run(
            tmp_path / "o",
            "a very long name, of many settings, that does not fit",
            {"a": 20.0},
            green,
        ),
    ]
    (compared,), _ = compare(records)
    (path,) = draw_sheet(compared, tmp_path / "sheets")
    assert path.name == "fern-3-a.png"
    sheet = iio.imread(path)[..., :3].astype(int)
    rows = [np.flatnonzero((sheet == color).all(-1).any(1)) for color in ((0, 0, 255), (0, 255, 0))]
    assert rows[0].max() < rows[1].min(), "one row above the other"
    columns = [
        np.flatnonzero((sheet == color).all(-1).any(0)) for color in ((0, 0, 255), (0, 255, 0))
    ]
    assert columns[0].min() == columns[1].min() and columns[0].max() == columns[1].max(), (
        "in the same columns"
    )
