"""What methods make of the same test view, at one scale and with one detail.

A run's pictures are strips of four panels: colour, depth, photograph, error. The error is computed
anew, so that all methods share its scale. Depth is coloured between the bounds of the scene, which
are the same for all its runs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from jaxtyping import Float, UInt8

from nerfreg.errors import NerfregError
from nerfreg.reports.records import NamedRun, Setting, by_method, by_setting
from nerfreg.runs.files import RENDERS, RESULTS

SCALES = (0.1, 0.2, 0.3, 0.5, 1.0)
"""Mean absolute colour errors that the brightest colour may stand for."""
CROP = 0.25
"""Side of the detail, as a share of the shorter side of the picture."""

Image = UInt8[np.ndarray, "_ _ 3"]


@dataclass(frozen=True)
class Rendered:
    """What one method makes of a view; colours of 0 to 255, the error of 0 to 1."""

    method: str
    folder: Path
    color: Image
    depth: Image
    photograph: Image

    @property
    def error(self) -> Float[np.ndarray, "height width"]:
        """Mean over the three channels of the absolute difference."""
        return np.asarray(np.abs(self._difference()).mean(-1) / 255)

    @property
    def psnr(self) -> float:
        """In dB; of equal images that of half a step of 1/255."""
        error = (self._difference() ** 2).mean() / 255**2
        return float(-10 * np.log10(max(error, (0.5 / 255) ** 2)))

    def _difference(self) -> Float[np.ndarray, "height width 3"]:
        return self.color.astype(np.float64) - self.photograph.astype(np.float64)


@dataclass(frozen=True)
class Crop:
    """A square of pixels: its upper left corner and its side."""

    top: int
    left: int
    side: int

    def of(self, image: Image) -> UInt8[np.ndarray, "side side 3"]:
        """Return the part of an image that it covers."""
        return image[self.top : self.top + self.side, self.left : self.left + self.side]


@dataclass(frozen=True)
class ComparedView:
    """All methods on one view.

    `crop` is where they differ most, and `scale` the error that is shown as the brightest.
    """

    setting: Setting
    view: str
    methods: tuple[Rendered, ...]
    crop: Crop
    scale: float

    @property
    def photograph(self) -> Image:
        """The same for all methods."""
        return self.methods[0].photograph

    @property
    def name(self) -> str:
        """What the page calls it in its address."""
        return f"{self.setting.name}/{self.view}"

    @property
    def title(self) -> str:
        """The setting and the view as a heading."""
        return f"{self.setting.title}: {self.view}"


def compare(
    runs: Sequence[NamedRun], views: Sequence[str] = ()
) -> tuple[list[ComparedView], list[str]]:
    """Compare the methods of every setting on some views, or if none is named, on telling ones.

    Of several seeds the smallest with pictures is shown.

    Returns:
        The views, and notes on what is not shown, and why.

    Raises:
        NerfregError: No run has a picture of a view, or a picture cannot be read.
    """
    compared: list[ComparedView] = []
    notes: list[str] = []
    known: set[str] = set()
    for setting, own in by_setting(runs).items():
        methods = by_method(run for run in own if views_of(run.folder))
        missing = [method for method in by_method(own) if method not in methods]
        if missing:
            notes.append(f"{setting.title}: no pictures of {', '.join(missing)}")
        firsts = [min(group, key=lambda run: run.seed) for group in methods.values()]
        known.update(view for run in firsts for view in views_of(run.folder))
        for view in views or telling_views([view_scores(run.folder) for run in firsts]):
            have = [run for run in firsts if view in views_of(run.folder)]
            compared += [_compared(setting, view, have, notes)] if have else []
    unknown = [view for view in views if view not in known]
    if unknown:
        has = f"views with pictures: {', '.join(sorted(known))}" if known else "no run has pictures"
        raise NerfregError(f"--views {','.join(unknown)}: no run has a picture of it; {has}")
    return compared, notes


def views_of(folder: Path) -> list[str]:
    """Return the names of the views that a run has pictures of."""
    paths = (folder / RENDERS).glob("*.png")
    return sorted(path.stem for path in paths if not path.name.startswith("."))


def view_scores(folder: Path) -> dict[str, float]:
    """Return PSNR of each view that a run has a picture of, as `results.json` says."""
    try:
        scores = json.loads((folder / RESULTS).read_text(encoding="utf-8"))["test_views"]
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    psnr = {view: scores.get(view, {}).get("psnr") for view in views_of(folder)}
    return {view: value for view, value in psnr.items() if value is not None}


def telling_views(scores: Sequence[Mapping[str, float]]) -> list[str]:
    """Return the views that tell most, of those that all methods have.

    They are the one of median PSNR (over the means of methods), and the one where the best and the
    worst method are furthest apart: one or two views, none if they have none in common.
    """
    common = sorted(set[str].intersection(*map(set, scores))) if scores else []
    if not common:
        return []
    values = {view: [own[view] for own in scores] for view in common}
    ranked = sorted(common, key=lambda view: sum(values[view]))
    median = ranked[(len(ranked) - 1) // 2]
    apart = max(common, key=lambda view: max(values[view]) - min(values[view]))
    return [median] if len(scores) == 1 or apart == median else [median, apart]


def read_strip(path: Path) -> tuple[Image, Image, Image]:
    """Return colour, depth and photograph of a run's picture.

    Raises:
        NerfregError: It cannot be read, or has not four panels.
    """
    try:
        image = iio.imread(path)
    except (OSError, ValueError, SyntaxError) as error:  # the last is Pillow's for a broken PNG
        advice = "make it anew with nerfreg render RUN"
        raise NerfregError(f"{path}: cannot be read ({error}); {advice}") from error
    if image.ndim != 3 or image.shape[2] != 3 or image.shape[1] % 4:
        parts = "colour, depth, photograph and error in three channels"
        raise NerfregError(f"{path}: {image.shape} is no strip of {parts}")
    color, depth, photograph, _ = np.split(image, 4, axis=1)
    return color, depth, photograph


def largest_difference(errors: Float[np.ndarray, "methods height width"], side: int) -> Crop:
    """Return the square over which the errors of the methods differ most.

    Of one method, it is the square where its error is largest.
    """
    spread = errors.max(0) - errors.min(0) if len(errors) > 1 else errors[0]
    integral = np.pad(spread.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    rows = integral[side:] - integral[:-side]
    sums = rows[:, side:] - rows[:, :-side]
    top, left = np.unravel_index(int(sums.argmax()), sums.shape)
    return Crop(int(top), int(left), side)


def shared_scale(errors: Float[np.ndarray, "methods height width"]) -> float:
    """Return the smallest of `SCALES` that no more than one pixel in a hundred exceeds."""
    bright = float(np.quantile(errors, 0.99))
    return next((scale for scale in SCALES if bright <= scale), SCALES[-1])


def _compared(
    setting: Setting, view: str, runs: Sequence[NamedRun], notes: list[str]
) -> ComparedView:
    """Compare runs; a photograph of another size than the first run's is left out with a note."""
    methods: list[Rendered] = []
    for run in runs:
        path = run.folder / RENDERS / f"{view}.png"
        rendered = Rendered(run.method, run.folder, *read_strip(path))
        size, first = rendered.color.shape[:2], (methods or [rendered])[0].color.shape[:2]
        if size == first:
            methods.append(rendered)
        else:
            notes.append(f"{path}: left out, {size} pixels instead of {first}")
    errors = np.stack([rendered.error for rendered in methods])
    crop = largest_difference(errors, max(1, round(CROP * min(errors.shape[1:]))))
    return ComparedView(setting, view, tuple(methods), crop, shared_scale(errors))
