"""Styles and names of figures, and the files that they are written to."""

from __future__ import annotations

from pathlib import Path

import pytest

from nerfreg.analysis.figures import panels, save, shortened, styles


def test_long_names_lose_their_middle() -> None:
    assert shortened("short", 5) == "short"
    assert shortened("abcdefghij", 5) == "ab…ij"
    assert len(shortened("x" * 100, 24)) == 24


def test_thirty_things_look_different() -> None:
    looks = {(style.color, style.marker, str(style.dash)) for style in styles(["x"] * 30)}
    assert len(looks) == 30


@pytest.mark.parametrize("columns", [2, (1.0, 2.0)])
def test_panels_and_files(tmp_path: Path, columns: int | tuple[float, ...]) -> None:
    with panels(1, columns, 4.0, 2.0) as (figure, ((left, right),)):
        left.set_title("N^2")
        paths = save(figure, tmp_path / "a.b")
    assert [path.name for path in paths] == ["a.b.png", "a.b.svg"]
    assert left.get_xscale() == right.get_yscale() == "log"
    assert paths[0].read_bytes().startswith(b"\x89PNG") and ">N^2<" in paths[1].read_text()
    widths = [panel.get_position().width for panel in (left, right)]
    assert widths[1] / widths[0] == pytest.approx(1.0 if columns == 2 else 2.0)
