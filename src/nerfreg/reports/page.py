"""The report as one page that needs nothing else: `report.html`, made of `template/`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nerfreg import __version__
from nerfreg.files import write_text
from nerfreg.reports.axes import duration
from nerfreg.reports.figures import Plot
from nerfreg.reports.grouping import by_setting, slug
from nerfreg.reports.inline import data_uris, themed_svg
from nerfreg.reports.pictures import Comparison, Crop, Pictures
from nerfreg.reports.records import RunRecord
from nerfreg.reports.sheet import DEPTH_MAP, ERROR_MAP, draw_sheets
from nerfreg.reports.tables import Table

if TYPE_CHECKING:
    from markupsafe import Markup

TEMPLATE = Path(__file__).parent / "template"
NAME, SHEETS = "report.html", "pictures"
PICTURE_BUDGET = 12_000_000
"""Characters that all pictures together may take, so that the page stays below 15 MB."""


@dataclass(frozen=True)
class Figure:
    """A figure on the page. svg: the element, trusted."""

    kind: str
    title: str
    svg: Markup


@dataclass(frozen=True)
class Picture:
    """What a method makes of a view, as data URIs. psnr: as text; "" of the photograph."""

    method: str
    psnr: str
    color: str
    detail: str
    error: str
    depth: str


@dataclass(frozen=True)
class View:
    """A view with the pictures of all methods. crop: the frame of the detail, as CSS. aspect: width over height."""

    name: str
    title: str
    photograph: Picture
    methods: tuple[Picture, ...]
    crop: str
    scale: str
    aspect: float


@dataclass(frozen=True)
class Run:
    """A run as the page lists it. state: "complete", "failed", or how far it has come. reason: why it failed."""

    method: str
    setting: str
    seed: int
    state: str
    reason: str
    folder: str
    command: str


def write(
    records: Sequence[RunRecord],
    tables: Sequence[Table],
    figures: Sequence[Plot],
    pictures: Pictures,
    folder: Path,
) -> Path:
    """Write FOLDER/report.html, and what it shows of test views as sheets in FOLDER/pictures; returns the page.

    figures: as `nerfreg.reports.figures.draw` has put them into the folder. pictures: of the test views to show.
    Raises NerfregError where a file cannot be written.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    draw_sheets(pictures.comparisons, folder / SHEETS)
    environment = Environment(
        loader=FileSystemLoader(TEMPLATE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["slug"] = slug
    parts = {
        path.name: Markup(path.read_text(encoding="utf-8"))
        for path in TEMPLATE.iterdir()
        if path.suffix != ".j2"
    }
    text = environment.get_template("report.html.j2").render(
        parts=parts,
        version=__version__,
        tables=tables,
        figures=[_figure(plot, folder) for plot in figures],
        views=_views(pictures.comparisons),
        notes=pictures.notes,
        runs=[_run(record) for record in records],
        settings=[setting.title for setting in by_setting(records)],
        methods=len({record.method for record in records}),
        error_map=_gradient(ERROR_MAP),
        depth_map=_gradient(DEPTH_MAP),
    )
    path = folder / NAME
    write_text(path, text)
    return path


def _figure(plot: Plot, folder: Path) -> Figure:
    from markupsafe import Markup

    svg = (folder / f"{plot.name}.svg").read_text(encoding="utf-8")
    return Figure(plot.kind, plot.title, Markup(themed_svg(svg, plot.name)))


def _views(comparisons: Sequence[Comparison]) -> list[View]:
    images = [image for comparison in comparisons for image in _images(comparison)]
    encoded = iter(data_uris(images, PICTURE_BUDGET))
    return [
        _view(comparison, [next(encoded) for _ in _images(comparison)])
        for comparison in comparisons
    ]


def _images(comparison: Comparison) -> list[Any]:
    """The photograph and its detail, then four pictures of each method."""
    crop = comparison.crop
    images = [comparison.photograph, crop.of(comparison.photograph)]
    for shown in comparison.methods:
        images += [
            shown.color,
            crop.of(shown.color),
            _error_colors(shown.error / comparison.scale),
            shown.depth,
        ]
    return images


def _view(comparison: Comparison, encoded: Sequence[str]) -> View:
    height, width = comparison.photograph.shape[:2]
    return View(
        name=f"{comparison.setting.name}/{comparison.view}",
        title=f"{comparison.setting.title}: {comparison.view}",
        photograph=Picture("photograph", "", encoded[0], encoded[1], "", ""),
        methods=tuple(
            Picture(shown.method, f"{shown.psnr:.2f} dB", *encoded[2 + 4 * index : 6 + 4 * index])
            for index, shown in enumerate(comparison.methods)
        ),
        crop=_frame(comparison.crop, height, width),
        scale=f"{comparison.scale:g}",
        aspect=width / height,
    )


def _frame(crop: Crop, height: int, width: int) -> str:
    shares = {"left": crop.left / width, "top": crop.top / height, "width": crop.side / width}
    shares["height"] = crop.side / height
    return ";".join(f"{side}:{100 * share:.2f}%" for side, share in shares.items())


def _error_colors(values: Any) -> Any:
    import matplotlib

    return (
        (matplotlib.colormaps[ERROR_MAP](np.clip(values, 0, 1))[..., :3] * 255)
        .round()
        .astype(np.uint8)
    )


def _gradient(name: str) -> str:
    """A colour map as the stops of a CSS gradient."""
    import matplotlib
    from matplotlib.colors import to_hex

    return ", ".join(to_hex(matplotlib.colormaps[name](stop)) for stop in np.linspace(0, 1, 11))


def _run(record: RunRecord) -> Run:
    last = record.evaluations[-1] if record.evaluations else None
    if record.failure is not None:
        state = "failed"
    elif record.final is not None:
        state = "complete"
    else:
        state = f"{duration(last.train_seconds)} so far" if last else "not scored yet"
    (setting,) = by_setting([record])
    command = shlex.join(["nerfreg", "train", *record.command])
    return Run(
        record.method,
        setting.title,
        record.seed,
        state,
        record.failure or "",
        str(record.folder),
        command,
    )
