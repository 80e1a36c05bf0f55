"""Score rendered views against the photographs of a scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from jaxtyping import Float
from torch import Tensor

from nerfreg.evaluation.lpips import LPIPS
from nerfreg.evaluation.metrics import average, depth_rmse, psnr, ssim
from nerfreg.hooks import EvaluatedView
from nerfreg.rendering.views import View
from nerfreg.scenes.scene import Scene


@dataclass(frozen=True)
class ViewScores:
    """Scores of one view; None for what could not be computed.

    Attributes:
        view: Number of the view.
        psnr: Peak signal-to-noise ratio in dB.
        ssim: Structural similarity.
        lpips: Perceptual distance.
        depth_rmse: Root mean squared error of depth, in world units.
        metrics: What plugins measured, by "plugin.metric".
    """

    view: int
    psnr: float
    ssim: float | None
    lpips: float | None
    depth_rmse: float | None
    metrics: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Scores:
    """Means of each score over views; None for what could not be computed on any view.

    Attributes:
        psnr: Peak signal-to-noise ratio in dB: the mean over views, not that of the mean error.
        ssim: Structural similarity.
        lpips: Perceptual distance.
        average: Geometric mean of three errors, from the means above (`metrics.average`).
        depth_rmse: Root mean squared error of depth, in world units.
        views: The scores of every view.
        metrics: What plugins measured, by "plugin.metric".
    """

    psnr: float
    ssim: float | None
    lpips: float | None
    average: float | None
    depth_rmse: float | None
    views: tuple[ViewScores, ...]
    metrics: Mapping[str, float | None] = field(default_factory=dict)

    @classmethod
    def of(cls, views: Sequence[ViewScores]) -> Scores:
        """Take the means over views, of which there must be at least one."""
        psnr = _mean(v.psnr for v in views)
        assert psnr is not None, "no view to score"
        ssim, lpips = _mean(v.ssim for v in views), _mean(v.lpips for v in views)
        depth_rmse = _mean(v.depth_rmse for v in views)
        names = dict.fromkeys(name for v in views for name in v.metrics)
        # A plugin says NaN for what it could not measure.
        metrics = {
            name: _mean(x for v in views if not math.isnan(x := v.metrics.get(name, math.nan)))
            for name in names
        }
        averaged = average(psnr, ssim, lpips)
        return cls(psnr, ssim, lpips, averaged, depth_rmse, tuple(views), metrics)

    def record(self) -> dict[str, Any]:
        """Return the means by name, as `metrics.jsonl` and `results.json` hold them."""
        names = ("psnr", "ssim", "lpips", "average", "depth_rmse")
        means: dict[str, Any] = {name: getattr(self, name) for name in names}
        return {**means, "metrics": dict(self.metrics)} if self.metrics else means


def score_views(
    scene: Scene,
    views: Sequence[int],
    render: Callable[[int], View],
    lpips: LPIPS | None,
    stride: int = 1,
    measure: Callable[[EvaluatedView], Mapping[str, float]] | None = None,
) -> Scores:
    """Render views and compare them with their photographs, and with true depth if it is known.

    Args:
        scene: The scene.
        views: The views to score.
        render: Renders a view at every `stride`-th row and column, from 0 on. Its colours are
            clipped to [0, 1] before they are scored.
        lpips: LPIPS; None leaves it out, and the average with it.
        stride: Stride between rows and columns. Above 1, SSIM and LPIPS are left out, and so is
            what plugins measure.
        measure: Returns what plugins measure of a view; None: nothing.

    Returns:
        The scores.
    """
    return Scores.of([_score(scene, view, render(view), lpips, stride, measure) for view in views])


def photograph(scene: Scene, view: int) -> Float[Tensor, "height width 3"]:
    """Read the image of a view, on the background of the scene if it has alpha.

    Args:
        scene: The scene.
        view: The view.

    Returns:
        Colours in [0, 1].
    """
    image = scene.read_image(view)
    if image.shape[-1] == 3:
        return image
    assert scene.background is not None, "a scene with alpha has a background"
    rgb, alpha = image[..., :3], image[..., 3:]
    return rgb * alpha + scene.background * (1 - alpha)


def _score(
    scene: Scene,
    view: int,
    rendered: View,
    lpips: LPIPS | None,
    stride: int,
    measure: Callable[[EvaluatedView], Mapping[str, float]] | None,
) -> ViewScores:
    target = photograph(scene, view)[::stride, ::stride]
    if rendered.rgb.shape != target.shape or rendered.depth.shape != target.shape[:2]:
        raise ValueError(
            f"view {view} was rendered as {tuple(rendered.rgb.shape)} with depth "
            f"{tuple(rendered.depth.shape)}, but its photograph is {tuple(target.shape)}"
        )
    rgb = rendered.rgb.detach().clamp(0, 1)
    # SSIM and LPIPS look at windows of pixels. On strided pixels these would see an image of
    # another scale, and the scores could not be compared with those at full size.
    truth = None if scene.read_depth is None else scene.read_depth(view)[::stride, ::stride]
    metrics: Mapping[str, float] = {}
    if measure is not None and stride == 1:
        metrics = measure(
            EvaluatedView(
                label=scene.labels[view] if scene.labels else str(view),
                pose=scene.cameras.poses[view],
                rgb=rgb,
                depth=rendered.depth.detach(),
                opacity=rendered.opacity.detach(),
                target=target,
                true_depth=truth,
            )
        )
    return ViewScores(
        view,
        psnr(rgb, target),
        ssim(rgb, target) if stride == 1 else None,
        lpips(rgb, target) if lpips is not None and stride == 1 else None,
        None if truth is None else depth_rmse(rendered.depth.detach(), truth),
        metrics,
    )


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    # `fsum` gives the same result in whatever order the views come, but refuses to add infinities,
    # which are the PSNR of identical images.
    total = math.fsum(known) if all(map(math.isfinite, known)) else sum(known)
    return total / len(known) if known else None
