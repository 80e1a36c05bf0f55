from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import pytest

from nerfreg.analysis import curves
from nerfreg.analysis.curves import Dot, draw_curves


def test_dots_lie_in_their_panels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures = []
    monkeypatch.setattr(curves, "save", lambda figure, stem: figures.append(figure) or [])
    dots = [
        Dot("error", "left", "one", 1, 0.5),
        Dot("error", "left", "one", 2, 1e-12),
        # Two at the same place, whose median is drawn, and one that has no logarithm.
        Dot("error", "right", "two", 1, 2.0),
        Dot("error", "right", "two", 1, 4.0),
        Dot("error", "right", "two", 0, 4.0),
        Dot("time", "left", "one", 1, 7.0),
    ]
    draw_curves(tmp_path / "x", dots, "Title", (6.0, 4.0), "samples", (1e-8, math.inf))
    (figure,) = figures
    left, right, below, empty = figure.axes
    assert [panel.get_title() for panel in figure.axes] == ["left", "right", "", ""]
    assert [panel.get_ylabel() for panel in figure.axes] == ["error", "", "time", ""]
    assert [panel.get_xlabel() for panel in figure.axes] == ["", "", "samples", "samples"]
    assert left.get_lines()[0].get_xydata().tolist() == [[1, 0.5], [2, 1e-8]]
    assert right.get_lines()[0].get_xydata().tolist() == [[1, 3.0]]
    assert below.get_lines()[0].get_color() == left.get_lines()[0].get_color()
    assert not empty.get_lines()
    assert left.get_ylim() == right.get_ylim()
    assert [label.get_text() for label in figure.legends[0].get_texts()] == ["one", "two"]


def test_files(tmp_path: Path) -> None:
    dots = [Dot("error", "", "one", n, 1 / n) for n in (1, 2, 4)]
    files = draw_curves(tmp_path / "curve", dots, "Title", (6.0, 4.0))
    assert files == [tmp_path / "curve.png", tmp_path / "curve.svg"]
    assert "Title" in "".join(ElementTree.parse(files[1]).getroot().itertext())
