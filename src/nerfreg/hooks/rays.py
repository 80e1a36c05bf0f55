"""Which rays a step renders: what plugins may ask for, and the rays that they get."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

NEIGHBORS = ("none", "patch", "extra")
"""Where adjacent pixels come from. Of two requests the one later in this list wins."""


@dataclass(frozen=True)
class Needs:
    """What a plugin wants rendered beside random training pixels.

    The union over all active plugins is rendered.

    Attributes:
        patch_size: Side S of square pixel patches among the training rays, 0 for none; the union
            takes the largest, and a plugin that asks for less gets them cut into patches of its
            own side.
        patch_fraction: Share of the training rays that lie in those patches.
        neighbors: Pairs of horizontally or vertically adjacent pixels, sampled at the same t.
            `"patch"` pairs rays of the patches (which are then at least 2 x 2) and costs no extra
            ray; `"extra"` renders one more ray, without a photograph behind it, for every training
            ray that lies in no patch.
        unseen_rays: Rays from poses between the training views, as a share of a step's rays. They
            take the place of training rays, so that a step costs no more.
        unseen_patches: Rays in patches of that side from such poses, likewise a share of a step's
            rays. They count as unseen rays: of both shares the larger is rendered.
    """

    patch_size: int = 0
    patch_fraction: float = 0.0
    neighbors: str = "none"
    unseen_rays: float = 0.0
    unseen_patches: float = 0.0

    def __or__(self, other: Needs) -> Needs:
        return Needs(
            max(self.patch_size, other.patch_size),
            max(self.patch_fraction, other.patch_fraction),
            max(self.neighbors, other.neighbors, key=NEIGHBORS.index),
            max(self.unseen_rays, other.unseen_rays),
            max(self.unseen_patches, other.unseen_patches),
        )


@dataclass
class Rays:
    """The rays of one step, or of a part of an image.

    Rays 0 to S-1 have a photograph behind them; the rest (extra neighbours, unseen views) do not.
    A plugin that wants other rays rendered (`Step.render`) gives the first four attributes, and
    whatever else it needs.

    Attributes:
        origins: (R, 3) in world units.
        directions: (R, 3) of unit length, so that t is a distance.
        near: (R,) start of the part of each ray that is sampled.
        far: (R,) its end.
        targets: (S, 3) colours in [0, 1]; by default there are none, and S is 0.
        background: (R, 3) what shines through where opacity is below 1; None where the photographs
            have no alpha.
        patches: (P, S, S) ray indices; rows run down the image, columns to the right. None if no
            plugin needs patches.
        neighbors: (M, 2) ray indices of adjacent pixels, first the ray, then its neighbour. Both
            share their t.
        unseen: (U,) indices of rays from unseen poses, or None.
        unseen_patches: (Q, S, S) those of them that form patches, or None.
        groups: (R,) rays with the same number share their t; None if no rays do.
        target_weights: (S,) what each target counts in the colour error, 1 on average; None where
            all are equal. A patch counts as much as one random pixel, since its pixels are nearly
            redundant.
        known_depth: (S, 2) interval of distance along the ray in which a plugin knew a surface
            before training; NaN where it did not, None if no plugin knew anything.
        view: (R,) number of the training view that each ray belongs to, from 0, as in
            `SceneInfo.cameras` and `Photographs.images`; -1 for all other rays, which are those of
            unseen poses and, in evaluation, those of views that are not trained on. None stands
            for -1 everywhere.
        pixel: (R, 2) the point (x, y) of its image that a ray goes through, in pixels; the centre
            of the top left pixel is at (0.5, 0.5). NaN for rays of unseen poses; None stands for
            NaN everywhere.
        unseen_views: (U,) the training view whose intrinsics each ray of `unseen` has, or None.
        data: What plugins prepared for each pixel (`nerfreg_prepare`), (S, ...) by the name
            "plugin.name"; empty in evaluation.
    """

    origins: Float[Tensor, "rays 3"]
    directions: Float[Tensor, "rays 3"]
    near: Float[Tensor, " rays"]
    far: Float[Tensor, " rays"]
    targets: Float[Tensor, "supervised 3"] = field(default_factory=lambda: torch.zeros(0, 3))
    background: Float[Tensor, "rays 3"] | None = None
    patches: Int[Tensor, "patches side side"] | None = None
    neighbors: Int[Tensor, "pairs 2"] | None = None
    unseen: Int[Tensor, " unseen"] | None = None
    unseen_patches: Int[Tensor, "unseen_patches width width"] | None = None
    groups: Int[Tensor, " rays"] | None = None
    target_weights: Float[Tensor, " supervised"] | None = None
    known_depth: Float[Tensor, "supervised 2"] | None = None
    view: Int[Tensor, " rays"] | None = None
    pixel: Float[Tensor, "rays 2"] | None = None
    unseen_views: Int[Tensor, " unseen"] | None = None
    data: Mapping[str, Tensor] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.origins)

    @property
    def seen(self) -> Bool[Tensor, " rays"]:
        """Which rays belong to a training view, (R,)."""
        if self.view is None:
            return self.near.new_zeros(len(self), dtype=torch.bool)
        return self.view >= 0

    def tiled(self, side: int) -> Rays:
        """Return the same rays with their patches cut into smaller ones.

        Args:
            side: Side of the smaller patches. Rays of a larger patch that fill no smaller one are
                left out; patches that are smaller already, and a side of 0, leave all as it is.
        """

        def cut(patches: Int[Tensor, "p s s"] | None) -> Int[Tensor, "q t t"] | None:
            if patches is None or not 0 < side < patches.shape[-1]:
                return patches
            count = patches.shape[-1] // side
            rows = patches[:, : count * side, : count * side].view(-1, count, side, count, side)
            return rows.transpose(2, 3).reshape(-1, side, side)

        patches, unseen_patches = cut(self.patches), cut(self.unseen_patches)
        return replace(self, patches=patches, unseen_patches=unseen_patches)

    def to(self, device: torch.device) -> Rays:
        """Return the same rays on a device."""
        moved: dict[str, Any] = {
            name: value.to(device)
            for name, value in vars(self).items()
            if isinstance(value, Tensor)
        }
        data = {name: values.to(device) for name, values in self.data.items()}
        return replace(self, **moved, data=data)

    def picked(self, index: Int[Tensor, " picked"]) -> Rays:
        """Return some of the rays, without targets and without what refers to rays by number.

        Args:
            index: (P,) numbers of rays.
        """
        return Rays(
            self.origins[index],
            self.directions[index],
            self.near[index],
            self.far[index],
            background=None if self.background is None else self.background[index],
            view=None if self.view is None else self.view[index],
            pixel=None if self.pixel is None else self.pixel[index],
        )
