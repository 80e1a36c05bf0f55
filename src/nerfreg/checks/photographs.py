"""Checks of `nerfreg_known_depth`: photographs that show little, or nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.checks.report import Report, Spot
from nerfreg.checks.subject import Subject
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.scene import Photographs
from nerfreg.training.contracts import Untouched

WIDTH, HEIGHT, BASELINE = 16, 12, 0.5
NEAR, FAR = 2.0, 10.0


@dataclass(frozen=True)
class PhotographCase:
    """Cameras in a row that look the same way, and what they see."""

    name: str
    description: str
    build: Callable[[], Photographs]


def check_known_depth(report: Report, subject: Subject, case: PhotographCase, spot: Spot) -> None:
    """What is known are intervals in order before the camera, or NaN; the photographs stay as they were."""
    photographs = case.build()
    watch = Untouched(photographs)
    # Shape and order are refused by the hooks themselves.
    known = subject.hooks().known_depth(photographs)
    report.judge("contract", spot, watch.edits())
    report.judge("value", spot, [] if known is None else wrong_intervals(known))


def wrong_intervals(known: Float[Tensor, "views height width 2"]) -> list[str]:
    """Both ends are known or neither is; the nearer one is not behind the camera, the farther one is finite."""
    first, last = known.unbind(-1)
    mistakes = {
        "one end is NaN and the other is not": first.isnan() != last.isnan(),
        "an interval begins behind the camera": first < 0,
        "an interval has no end": last.isinf(),
    }
    return [
        f"{line}, in {int(where.sum())} pixels"
        for line, where in mistakes.items()
        if bool(where.any())
    ]


def _photographs(
    views: int = 3,
    width: int = WIDTH,
    height: int = HEIGHT,
    baseline: float = BASELINE,
    near: float = NEAR,
    scale: float = 1.0,
    contrast: float = 1.0,
    alpha: float | None = None,
) -> Photographs:
    poses = torch.eye(3, 4).repeat(views, 1, 1)
    poses[:, 0, 3] = scale * baseline * torch.arange(views)
    focal, center = (
        torch.full((views, 2), float(width)),
        torch.tensor([width / 2, height / 2]).expand(views, 2),
    )
    noise = torch.rand(views, height, width, 3, generator=torch.Generator().manual_seed(0))
    images = 0.5 + contrast * (noise - 0.5)
    if alpha is not None:
        images = torch.cat([images, torch.full((views, height, width, 1), alpha)], dim=-1)
    cameras = Cameras(width, height, poses, focal, center, torch.zeros(views, 5))
    return Photographs(cameras, images, scale * near, scale * FAR, "forward")


PHOTOGRAPH_CASES = (
    PhotographCase("photos_noise", "photographs: noise, three views", _photographs),
    PhotographCase("photos_one", "photographs: one view", lambda: _photographs(views=1)),
    PhotographCase(
        "photos_flat", "photographs: all of one colour", lambda: _photographs(contrast=0.0)
    ),
    PhotographCase(
        "photos_empty", "photographs: wholly transparent", lambda: _photographs(alpha=0.0)
    ),
    PhotographCase(
        "photos_same_place",
        "photographs: cameras that did not move",
        lambda: _photographs(baseline=0.0),
    ),
    PhotographCase(
        "photos_apart",
        "photographs: cameras that see nothing in common",
        lambda: _photographs(baseline=1e4),
    ),
    PhotographCase(
        "photos_near_0",
        "photographs: rays that begin at the camera",
        lambda: _photographs(near=0.0),
    ),
    PhotographCase(
        "photos_pixel", "photographs: one pixel each", lambda: _photographs(width=1, height=1)
    ),
    PhotographCase("photos_huge", "photographs: a scene of 1e6", lambda: _photographs(scale=1e6)),
    PhotographCase("photos_tiny", "photographs: a scene of 1e-6", lambda: _photographs(scale=1e-6)),
)
