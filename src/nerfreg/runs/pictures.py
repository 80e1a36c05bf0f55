"""Render test views for scoring, and save pictures of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from nerfreg.config.schema import Config
from nerfreg.evaluation.config import subset_of
from nerfreg.evaluation.images import save_png, side_by_side
from nerfreg.evaluation.scores import photograph
from nerfreg.field import RadianceField
from nerfreg.rendering.views import View, ViewRenderer
from nerfreg.runs.files import RENDERS
from nerfreg.runs.results import view_label
from nerfreg.scenes import Scene

RenderView = Callable[[int], View]


def strided(field: RadianceField, config: Config, scene: Scene) -> RenderView:
    """Return a function that renders every `eval.pixels_stride`-th row and column of a view.

    Args:
        field: The trained field, which must not change while the function is in use.
        config: Configuration of the run.
        scene: Its scene.
    """
    renderer = ViewRenderer(field, config.sampler, scene)
    return lambda view: renderer.view(scene.cameras, view, config.eval.pixels_stride)


def saving(field: RadianceField, config: Config, scene: Scene, run: Path) -> RenderView:
    """Return a function that renders views at full size, and saves pictures of some.

    The pictures of as many test views as `eval.save_renders` says go to RUN/renders.

    Args:
        field: The trained field, which must not change while the function is in use.
        config: Configuration of the run.
        scene: Its scene.
        run: The run's folder.
    """
    renderer = ViewRenderer(field, config.sampler, scene)
    count = config.eval.save_renders
    saved = set(scene.test if count is None else subset_of(scene.test, count))

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
