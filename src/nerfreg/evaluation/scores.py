"""Score rendered views against the photographs of a scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from nerfreg.evaluation.lpips import LPIPS
from nerfreg.evaluation.metrics import average, depth_rmse, psnr, ssim
from nerfreg.rendering.views import View
from nerfreg.scenes.scene import Scene


@dataclass(frozen=True)
class ViewScores:
    """Scores of one view; None for what could not be computed."""

    view: int
    psnr: float
    ssim: float | None
    lpips: float | None
    depth_rmse: float | None


@dataclass(frozen=True)
class Scores:
    """Means over views of each score, the geometric mean of those means, and the scores of every view.

    None stands for what could not be computed on a single view.
    """

    psnr: float
    ssim: float | None
    lpips: float | None
    average: float | None
    depth_rmse: float | None
    views: tuple[ViewScores, ...]

    @classmethod
    def of(cls, views: Sequence[ViewScores]) -> Scores:
        """Take the mean over views."""
        psnr = _mean(v.psnr for v in views)
        assert psnr is not None, "no view to score"
        ssim, lpips = _mean(v.ssim for v in views), _mean(v.lpips for v in views)
        depth_rmse = _mean(v.depth_rmse for v in views)
        return cls(psnr, ssim, lpips, average(psnr, ssim, lpips), depth_rmse, tuple(views))

    def record(self) -> dict[str, float | None]:
        """The means by name, as they stand in `metrics.jsonl` and `results.json`."""
        return {
            name: getattr(self, name) for name in ("psnr", "ssim", "lpips", "average", "depth_rmse")
        }


def score_views(
    scene: Scene,
    views: Sequence[int],
    render: Callable[[int], View],
    lpips: LPIPS | None,
    stride: int = 1,
) -> Scores:
    """Render the views and compare them with their photographs, and with true depth where the scene knows it.

    render: view -> what was rendered, at every `stride`-th row and column from 0; colours are clipped to [0, 1].
    lpips: None leaves out LPIPS and the average. With a stride above 1 SSIM and LPIPS are left out: their windows
    would see an image of another scale, and the numbers could not be compared with those at full size.
    """
    return Scores.of([_score(scene, view, render(view), lpips, stride) for view in views])


def photograph(scene: Scene, view: int) -> Float[Tensor, "height width 3"]:
    """The image of a view; where it has alpha, on the scene's background."""
    image = scene.read_image(view)
    if image.shape[-1] == 3:
        return image
    assert scene.background is not None, "a scene with alpha has a background"
    rgb, alpha = image[..., :3], image[..., 3:]
    return rgb * alpha + scene.background * (1 - alpha)


def _score(scene: Scene, view: int, rendered: View, lpips: LPIPS | None, stride: int) -> ViewScores:
    target = photograph(scene, view)[::stride, ::stride]
    if rendered.rgb.shape != target.shape or rendered.depth.shape != target.shape[:2]:
        raise ValueError(
            f"view {view} was rendered as {tuple(rendered.rgb.shape)} with depth {tuple(rendered.depth.shape)}, "
            f"its photograph is {tuple(target.shape)}"
        )
    rgb = rendered.rgb.detach().clamp(0, 1)
    truth = None if scene.read_depth is None else scene.read_depth(view)[::stride, ::stride]
    return ViewScores(
        view,
        psnr(rgb, target),
        ssim(rgb, target) if stride == 1 else None,
        lpips(rgb, target) if lpips is not None and stride == 1 else None,
        None if truth is None else depth_rmse(rendered.depth.detach(), truth),
    )


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    # fsum: the same result in whatever order the views come; it refuses to add infinities
    total = math.fsum(known) if all(map(math.isfinite, known)) else sum(known)
    return total / len(known) if known else None
