"""What methods make of the same test view: photograph, colour, error and depth, at one scale and with one crop.

A run's pictures are strips of four panels: colour, depth, photograph, error. The error is computed anew, so that all
methods share its scale. Depth is coloured between the bounds of the scene, which are the same for all its runs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from nerfreg.errors import NerfregError
from nerfreg.reports.grouping import Setting, by_method, by_setting
from nerfreg.reports.records import RunRecord
from nerfreg.runs.files import RENDERS, RESULTS

SCALES = (0.1, 0.2, 0.3, 0.5, 1.0)
"""Mean absolute colour errors that the brightest colour may stand for."""
CROP = 0.25
"""Side of the detail, as a share of the shorter side of the picture."""


@dataclass(frozen=True)
class Strip:
    """A picture of a run, cut apart. Colours of 0 to 255."""

    color: UInt8[np.ndarray, "height width 3"]
    depth: UInt8[np.ndarray, "height width 3"]
    photograph: UInt8[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class Shown:
    """What one method makes of a view. error: mean absolute colour error, 0 to 1."""

    method: str
    folder: Path
    psnr: float
    color: UInt8[np.ndarray, "height width 3"]
    depth: UInt8[np.ndarray, "height width 3"]
    error: Float[np.ndarray, "height width"]


@dataclass(frozen=True)
class Crop:
    """A square of pixels: its upper left corner and its side."""

    top: int
    left: int
    side: int

    def of(self, image: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "side side 3"]:
        """The part of an image that it covers."""
        return image[self.top : self.top + self.side, self.left : self.left + self.side]


@dataclass(frozen=True)
class Comparison:
    """All methods on one view. crop: where they differ most. scale: the error that is shown as the brightest."""

    setting: Setting
    view: str
    photograph: UInt8[np.ndarray, "height width 3"]
    methods: tuple[Shown, ...]
    crop: Crop
    scale: float


@dataclass(frozen=True)
class Pictures:
    """notes: what is not shown, and why."""

    comparisons: tuple[Comparison, ...]
    notes: tuple[str, ...]


def compare(records: Sequence[RunRecord], views: Sequence[str]) -> Pictures:
    """Compare the methods of every setting on some views: those named, or (if none is) those that tell most.

    Of several seeds the smallest with pictures is shown. Methods without pictures are left out with a note. Raises
    NerfregError for a view that no run has a picture of, and for a picture that cannot be read.
    """
    comparisons: list[Comparison] = []
    notes: list[str] = []
    known: set[str] = set()
    for setting, runs in by_setting(records).items():
        shown = {
            method: run
            for method, own in by_method(runs).items()
            if (run := _with_pictures(own)) is not None
        }
        missing = [method for method in by_method(runs) if method not in shown]
        if missing:
            notes.append(f"{setting.title}: no pictures of {', '.join(missing)}")
        folders = {method: run.folder for method, run in shown.items()}
        available = {method: set(views_of(folder)) for method, folder in folders.items()}
        known |= set().union(*available.values())
        for view in views or telling_views(
            {method: view_scores(folder) for method, folder in folders.items()}
        ):
            have = {
                method: folder for method, folder in folders.items() if view in available[method]
            }
            if have:
                comparisons.append(_comparison(setting, view, have, notes))
    unknown = [view for view in views if view not in known]
    if unknown:
        has = f"views with pictures: {', '.join(sorted(known))}" if known else "no run has pictures"
        raise NerfregError(f"--views {','.join(unknown)}: no run has a picture of it; {has}")
    return Pictures(tuple(comparisons), tuple(notes))


def views_of(folder: Path) -> list[str]:
    """The views that a run has pictures of, by name."""
    return sorted(
        path.stem for path in (folder / RENDERS).glob("*.png") if not path.name.startswith(".")
    )


def view_scores(folder: Path) -> dict[str, float]:
    """PSNR of each view that a run has a picture of, as `results.json` says."""
    try:
        scores = json.loads((folder / RESULTS).read_text(encoding="utf-8"))["test_views"]
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return {
        view: scores[view]["psnr"]
        for view in views_of(folder)
        if scores.get(view, {}).get("psnr") is not None
    }


def telling_views(scores: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Of the views that all methods have: the one of median PSNR (over the means of methods), and the one where the
    best and the worst method are furthest apart. One or two views; none if they have none in common.
    """
    common = sorted(set[str].intersection(*(set(own) for own in scores.values()))) if scores else []
    if not common:
        return []
    values = {view: [own[view] for own in scores.values()] for view in common}
    ranked = sorted(common, key=lambda view: sum(values[view]))
    median = ranked[(len(ranked) - 1) // 2]
    apart = max(common, key=lambda view: max(values[view]) - min(values[view]))
    return [median] if len(scores) == 1 or apart == median else [median, apart]


def read_strip(path: Path) -> Strip:
    """Cut a picture of a run apart. Raises NerfregError if it cannot be read or has not four panels."""
    import imageio.v3 as iio

    try:
        image = iio.imread(path)
    except (OSError, ValueError, SyntaxError) as error:  # the last is Pillow's for a broken PNG
        raise NerfregError(
            f"{path}: cannot be read ({error}); make it anew with nerfreg render RUN"
        ) from error
    if image.ndim != 3 or image.shape[2] != 3 or image.shape[1] % 4:
        raise NerfregError(
            f"{path}: {image.shape} is no strip of colour, depth, photograph and error in three channels"
        )
    color, depth, photograph, _ = np.split(image, 4, axis=1)
    return Strip(color, depth, photograph)


def error_map(
    color: UInt8[np.ndarray, "height width 3"], photograph: UInt8[np.ndarray, "height width 3"]
) -> Float[np.ndarray, "height width"]:
    """Mean over the three channels of the absolute difference, 0 to 1."""
    return np.abs(color.astype(np.float64) - photograph.astype(np.float64)).mean(-1) / 255


def psnr(
    color: UInt8[np.ndarray, "height width 3"], photograph: UInt8[np.ndarray, "height width 3"]
) -> float:
    """Peak signal-to-noise ratio in dB; of equal images that of half a step of 1/255."""
    error = float(((color.astype(np.float64) - photograph.astype(np.float64)) ** 2).mean()) / 255**2
    return float(-10 * np.log10(max(error, (0.5 / 255) ** 2)))


def largest_difference(errors: Float[np.ndarray, "methods height width"], side: int) -> Crop:
    """The square over which the errors of the methods differ most; of one method, where its error is largest."""
    spread = errors.max(0) - errors.min(0) if len(errors) > 1 else errors[0]
    integral = np.pad(spread.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    sums = (
        integral[side:, side:]
        - integral[:-side, side:]
        - integral[side:, :-side]
        + integral[:-side, :-side]
    )
    top, left = np.unravel_index(int(sums.argmax()), sums.shape)
    return Crop(int(top), int(left), side)


def shared_scale(errors: Float[np.ndarray, "methods height width"]) -> float:
    """The smallest of SCALES that no more than one pixel in a hundred exceeds."""
    bright = float(np.quantile(errors, 0.99))
    return next((scale for scale in SCALES if bright <= scale), SCALES[-1])


def _with_pictures(runs: Sequence[RunRecord]) -> RunRecord | None:
    return min(
        (run for run in runs if views_of(run.folder)), key=lambda run: run.seed, default=None
    )


def _comparison(
    setting: Setting, view: str, folders: Mapping[str, Path], notes: list[str]
) -> Comparison:
    """Methods whose photograph is not the first method's, in size, are left out with a note."""
    photograph: UInt8[np.ndarray, "height width 3"] | None = None
    methods: list[Shown] = []
    for method, folder in folders.items():
        path = folder / RENDERS / f"{view}.png"
        strip = read_strip(path)
        if photograph is None:
            photograph = strip.photograph
        elif photograph.shape != strip.photograph.shape:
            notes.append(
                f"{path}: left out, {strip.photograph.shape[:2]} pixels instead of {photograph.shape[:2]}"
            )
            continue
        error = error_map(strip.color, strip.photograph)
        methods.append(
            Shown(
                method, folder, psnr(strip.color, strip.photograph), strip.color, strip.depth, error
            )
        )
    assert photograph is not None
    errors = np.stack([shown.error for shown in methods])
    crop = largest_difference(errors, max(1, round(CROP * min(photograph.shape[:2]))))
    return Comparison(setting, view, photograph, tuple(methods), crop, shared_scale(errors))
