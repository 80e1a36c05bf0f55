"""Checks of `nerfreg_known_depth`: photographs that show little, or nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch

from nerfreg.checks.report import Report, Spot, UnpreparedError
from nerfreg.checks.small_field import FEATURES
from nerfreg.checks.watch import WatchedHooks
from nerfreg.errors import NerfregError, PluginError
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.scene import Photographs
from nerfreg.training.contracts import Untouched, wrong_known_depth

FAR = 10.0


@dataclass(frozen=True)
class PhotographCase:
    """Cameras in a row that look the same way at noise.

    Attributes:
        views: Number of photographs, of `width` x `height` pixels.
        baseline: Distance between neighbouring cameras; like `near`, in units of `scale`.
        contrast: Of the noise, from 0 (grey) to 1.
        alpha: Opacity of all pixels; None: there is no such channel.
    """

    name: str
    description: str
    views: int = 3
    width: int = 16
    height: int = 12
    baseline: float = 0.5
    near: float = 2.0
    scale: float = 1.0
    contrast: float = 1.0
    alpha: float | None = None

    def points(
        self, dtypes: Sequence[str], samples: int | None
    ) -> Iterator[tuple[Spot, Photographs]]:
        """Yield the photographs, which are read as float32; there are no samples."""
        if "float32" in dtypes:
            yield Spot(self.name, "float32"), self.build()

    def build(self) -> Photographs:
        """Return the photographs, the same every time."""
        views, height, width = shape = self.views, self.height, self.width
        poses = torch.eye(3, 4).repeat(views, 1, 1)
        poses[:, 0, 3] = self.scale * self.baseline * torch.arange(views)
        focal = torch.full((views, 2), float(width))
        center = torch.tensor([width / 2, height / 2]).expand(views, 2)
        noise = torch.rand(*shape, 3, generator=torch.Generator().manual_seed(0))
        images = 0.5 + self.contrast * (noise - 0.5)
        if self.alpha is not None:
            images = torch.cat([images, torch.full((*shape, 1), self.alpha)], dim=-1)
        cameras = Cameras(width, height, poses, focal, center, torch.zeros(views, 5))
        reach = self.scale * FAR
        return Photographs(
            cameras=cameras,
            images=images,
            box=torch.tensor([[-reach] * 3, [reach] * 3]),
            near=self.scale * self.near,
            far=reach,
            layout="forward",
        )


PHOTOGRAPH_CASES = (
    PhotographCase("photos_noise", "photographs: noise, three views"),
    PhotographCase("photos_one", "photographs: one view", views=1),
    PhotographCase("photos_flat", "photographs: all of one colour", contrast=0.0),
    PhotographCase("photos_empty", "photographs: wholly transparent", alpha=0.0),
    PhotographCase("photos_same_place", "photographs: cameras that did not move", baseline=0.0),
    PhotographCase("photos_apart", "photographs: cameras that see nothing in common", baseline=1e4),
    PhotographCase("photos_near_0", "photographs: rays that begin at the camera", near=0.0),
    PhotographCase("photos_pixel", "photographs: one pixel each", width=1, height=1),
    PhotographCase("photos_huge", "photographs: a scene of 1e6", scale=1e6),
    PhotographCase("photos_tiny", "photographs: a scene of 1e-6", scale=1e-6),
)


def check_known_depth(report: Report, _: PhotographCase, photographs: Photographs) -> None:
    """Check that what is known are intervals in order before the camera, or NaN."""
    watch = Untouched(photographs)
    # Shape and order are refused by the hooks themselves.
    known = report.subject.hooks().known_depth(photographs)
    report.judge("contract", watch.edits())
    report.judge("value", [] if known is None else wrong_known_depth(known))


def check_prepare(report: Report, _: PhotographCase, photographs: Photographs) -> None:
    """Check that what is prepared are values of each pixel."""
    hooks = WatchedHooks(report.subject.selected())
    # As in a run: a plugin may put what it finds out into a buffer of its module.
    hooks.modules(photographs, FEATURES)
    try:
        hooks.prepare(photographs)
    except PluginError:
        raise
    except NerfregError as error:
        raise UnpreparedError(f"nerfreg_prepare: {error}") from error
    for check in ("contract", "effects"):
        report.judge(check, hooks.take(check))
