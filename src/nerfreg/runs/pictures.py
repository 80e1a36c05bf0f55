"""Render test views for scoring, and save pictures of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from nerfreg.evaluation.config import subset_of
from nerfreg.evaluation.images import save_png, side_by_side
from nerfreg.evaluation.scores import photograph
from nerfreg.evaluation.trained import TrainedField
from nerfreg.rendering.views import View
from nerfreg.runs.files import RENDERS
from nerfreg.runs.results import view_label
from nerfreg.scenes import Scene

RenderView = Callable[[int], View]


def strided(trained: TrainedField, stride: int) -> RenderView:
    """Return a function that renders every `stride`-th row and column of a view.

    Args:
        trained: The trained field, which must not change while the function is in use.
        stride: Stride between rows and columns.
    """
    renderer = trained.renderer()
    return lambda view: renderer.view(trained.scene.cameras, view, stride)


def saving(trained: TrainedField, save_renders: int | None, run: Path) -> RenderView:
    """Return a function that renders views at full size, and saves pictures of some.

    Args:
        trained: The trained field, which must not change while the function is in use.
        save_renders: Of how many test views a picture goes to RUN/renders; None: of all.
        run: The run's folder.
    """
    renderer, scene = trained.renderer(), trained.scene
    test = scene.test
    saved = set(test if save_renders is None else subset_of(test, save_renders))

    def render(view: int) -> View:
        rendered = renderer.view(scene.cameras, view)
        if view in saved:
            save_view(run / RENDERS, scene, view, rendered)
        return rendered

    return render


def save_view(folder: Path, scene: Scene, view: int, rendered: View) -> None:
    """Save colour, depth, photograph and error of a view side by side as PNG.

    Args:
        folder: Where the picture is saved, under the name of the view.
        scene: The scene, for the photograph and the range of the depth.
        view: Index of the view in the scene.
        rendered: The rendered view, at full size.
    """
    picture = side_by_side(
        rendered.rgb,
        rendered.depth,
        scene.near,
        scene.far,
        rendered.opacity,
        photograph(scene, view),
    )
    save_png(folder / f"{view_label(scene, view)}.png", picture)
