"""Describe a scene in words, and draw its cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.scenes import bounds, layouts
from nerfreg.scenes.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TRAIN_COLOR, TEST_COLOR, BOX_COLOR, POINT_COLOR = "#d1495b", "#30638e", "#8d99ae", "#1b9e77"
LISTED = 12
"""Most views that are listed by name; of more, the first ones and the last."""


def describe(scene: Scene) -> str:
    """Describe what was found: cameras, split, bounds, alpha and depth.

    Args:
        scene: The scene.

    Returns:
        A few lines of text.
    """
    cameras, views = scene.cameras, [*scene.train, *scene.test]
    focal, center = cameras.focal[views], cameras.center[views]
    angles = torch.rad2deg(
        2 * torch.atan(0.5 * torch.tensor([cameras.width, cameras.height]) / focal)
    ).mean(0)
    distortion = cameras.distortion[views]
    size = scene.box[1] - scene.box[0]
    background = "none (opaque photographs)"
    if scene.background is not None:
        background = f"{_numbers(scene.background)} behind the alpha channel"
    lines = [
        ("scene", scene.name),
        ("layout", _layout(scene)),
        ("images", f"{len(cameras)} known, {cameras.width} x {cameras.height} pixels"),
        ("background", background),
        ("focal length", f"{_range(focal[:, 0])} x {_range(focal[:, 1])} pixels"),
        ("field of view", f"{float(angles[0]):.1f} x {float(angles[1]):.1f} degrees"),
        ("centre", f"{_range(center[:, 0])}, {_range(center[:, 1])} pixels"),
        ("distortion", _distortion(distortion)),
        ("training", _views(scene, scene.train)),
        ("test", _views(scene, scene.test)),
        ("near, far", f"{scene.near:.4g}, {scene.far:.4g}"),
        (
            "box",
            f"{_numbers(scene.box[0])} to {_numbers(scene.box[1])}, "
            f"{' x '.join(f'{s:.4g}' for s in size)}",
        ),
        ("depth", "known" if scene.read_depth else "unknown"),
    ]
    shared = sorted({*scene.train} & {*scene.test})
    if shared:
        lines.append(
            (
                "note",
                f"views {', '.join(map(str, shared))} are used for both training and test: "
                "scores will be too good",
            )
        )
    return "\n".join(f"{name:<14}{text}" for name, text in lines)


def draw_cameras(scene: Scene, path: Path) -> None:
    """Draw the cameras of the split from above and from the side, with the box.

    Args:
        scene: The scene.
        path: The PNG file to write.

    Raises:
        NerfregError: If the file cannot be written.
    """
    # matplotlib takes long to import; `Figure` by itself needs neither pyplot nor a display.
    from matplotlib.figure import Figure

    top, side = _views_of_world(scene)
    figure = Figure(figsize=(13, 6.4), layout="constrained")
    figure.suptitle(
        f"{scene.name}: {len(scene.train)} training and {len(scene.test)} test views, "
        f"near {scene.near:.3g}, far {scene.far:.3g}",
        fontsize=13,
    )
    for column, (title, projection) in enumerate((("from above", top), ("from the side", side))):
        axes = figure.add_subplot(1, 2, column + 1)
        axes.set_title(title, fontsize=11)
        _draw_panel(axes, scene, projection)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    try:
        figure.savefig(path, format="png")
    except OSError as error:
        raise NerfregError(f"{path}: cannot be written: {error.strerror or error}") from None


class _Projection(NamedTuple):
    """The world axes that a panel shows to the right and upwards, and their signs there."""

    right: int
    right_sign: float
    up: int
    up_sign: float

    def __call__(self, points: Float[Tensor, "points 3"]) -> Float[np.ndarray, "points 2"]:
        return np.stack((points[:, self.right].numpy(), points[:, self.up].numpy()), axis=1)


def _views_of_world(scene: Scene) -> tuple[_Projection, _Projection]:
    """The views from above and from the side.

    The viewing direction of forward-facing cameras points up in the first and right in the second.
    """
    # The world axis nearest to the mean up direction of the images: files use y or z, of either
    # sign.
    views = [*scene.train, *scene.test]
    upward, forward = scene.cameras.poses[views, :, 1].mean(0), scene.cameras.axes[views].mean(0)
    up = int(upward.abs().argmax())
    up_sign = 1.0 if upward[up] > 0 else -1.0
    first, second = (axis for axis in range(3) if axis != up)
    ahead = first if not scene.around and abs(forward[first]) > abs(forward[second]) else second
    across = first if ahead == second else second
    ahead_sign = -1.0 if not scene.around and forward[ahead] < 0 else 1.0
    # So that the view from above is no mirror image: right x ahead = up must hold.
    cycle = 1.0 if (across + 1) % 3 == ahead else -1.0
    across_sign = cycle * ahead_sign * up_sign
    return _Projection(across, across_sign, ahead, ahead_sign), _Projection(
        ahead, ahead_sign, up, up_sign
    )


def _draw_panel(axes: Axes, scene: Scene, projection: _Projection) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Rectangle

    low, high = projection(scene.box)
    width, height = high - low
    axes.add_patch(
        Rectangle(
            (low[0], low[1]), width, height, fill=False, color=BOX_COLOR, linewidth=1.5, label="box"
        )
    )
    positions = projection(scene.cameras.positions[[*scene.train, *scene.test]])
    extent = float((np.maximum(high, positions.max(0)) - np.minimum(low, positions.min(0))).max())
    shown = [low, high, *positions]
    if scene.around or len(scene.train) > 1:
        point = projection(bounds.look_at_point(scene.cameras, scene.train)[None])[0]
        axes.scatter(
            point[0], point[1], marker="+", s=90, color=POINT_COLOR, label="look-at point", zorder=4
        )
        shown.append(point)
    if scene.around:
        shown += _draw_frusta(axes, scene, projection, 0.09 * extent)
    else:
        _draw_frusta(axes, scene, projection, 0.04 * extent)
        for view in scene.train:
            apex = projection(scene.cameras.positions[view][None])[0]
            # Lines of sight go on to the far side of the box, seen from its centre.
            reach = (
                float(
                    (scene.box.mean(0) - scene.cameras.positions[view]) @ scene.cameras.axes[view]
                )
                * 2
            )
            edges = [
                (apex, corner) for corner in projection(bounds.frustum(scene.cameras, view, reach))
            ]
            axes.add_collection(LineCollection(edges, color=TRAIN_COLOR, linewidth=0.5, alpha=0.3))
        _draw_closeup(axes, scene, projection, positions)
    _frame_panel(axes, np.stack(shown), projection)
    axes.set_xlabel("xyz"[projection.right])
    axes.set_ylabel("xyz"[projection.up])
    axes.grid(color="#e5e5e5", linewidth=0.6)
    axes.set_axisbelow(True)


def _draw_frusta(
    axes: Axes, scene: Scene, projection: _Projection, length: float
) -> list[Float[np.ndarray, " 2"]]:
    """Draw all cameras of the split as pyramids of some length, and return their corners."""
    from matplotlib.collections import LineCollection, PolyCollection

    corners = []
    for views, color, name in (
        (scene.test, TEST_COLOR, "test"),
        (scene.train, TRAIN_COLOR, "training"),
    ):
        outlines = [projection(bounds.frustum(scene.cameras, view, length)) for view in views]
        apexes = projection(scene.cameras.positions[list(views)])
        edges = [
            (apex, corner)
            for apex, outline in zip(apexes, outlines, strict=True)
            for corner in outline
        ]
        axes.add_collection(
            PolyCollection(outlines, facecolor=color, edgecolor=color, alpha=0.25, linewidth=0.8)
        )
        axes.add_collection(LineCollection(edges, color=color, linewidth=1.0, alpha=0.8))
        axes.scatter(apexes[:, 0], apexes[:, 1], s=14, color=color, label=name, zorder=3)
        corners += [corner for outline in outlines for corner in outline]
    return corners


def _draw_closeup(
    axes: Axes, scene: Scene, projection: _Projection, positions: Float[np.ndarray, "views 2"]
) -> None:
    """Show cameras side by side larger in an inset: beside what they see they are but a dot."""
    spread = float((positions.max(0) - positions.min(0)).max())
    if spread == 0:
        return
    inset = axes.inset_axes((0.62, 0.6, 0.36, 0.36))
    corners = _draw_frusta(inset, scene, projection, 0.15 * spread)
    _frame_panel(inset, np.stack((*positions, *corners)), projection)
    inset.tick_params(labelsize=7)
    inset.set_title("the cameras", fontsize=8, pad=3)
    inset.grid(color="#e5e5e5", linewidth=0.5)
    inset.set_axisbelow(True)


def _frame_panel(axes: Axes, shown: Float[np.ndarray, "points 2"], projection: _Projection) -> None:
    low, high = shown.min(0), shown.max(0)
    half_side = 0.56 * float((high - low).max())
    (left, bottom), (right, top) = (low + high) / 2 - half_side, (low + high) / 2 + half_side
    axes.set_xlim(*((left, right) if projection.right_sign > 0 else (right, left)))
    axes.set_ylim(*((bottom, top) if projection.up_sign > 0 else (top, bottom)))
    axes.set_aspect("equal")


def _layout(scene: Scene) -> str:
    # Without the name, with which the line begins where it stands alone.
    line = layouts.said(scene.name, scene.layout).removeprefix(f"{scene.name}: ")
    return line if scene.layout_found else line.partition(";")[0]


def _numbers(values: Tensor) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values.tolist()) + ")"


def _range(values: Tensor) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.5g}" if high - low < 1e-3 * abs(high) else f"{low:.5g} to {high:.5g}"


def _distortion(values: Float[Tensor, "views 5"]) -> str:
    if not values.any():
        return "none"
    return ", ".join(
        f"{name} {_range(column)}"
        for name, column in zip(("k1", "k2", "p1", "p2", "k3"), values.T, strict=True)
    )


def _views(scene: Scene, views: Sequence[int]) -> str:
    names = [scene.labels[view] if scene.labels else str(view) for view in views]
    more = f", ... {names[-1]}" if len(names) > LISTED else ""
    return f"{len(views)} views: {', '.join(names[: LISTED - 1] if more else names)}{more}"
