"""Draw the rays of a step from all training images at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.hooks import Needs, OccupancyGrid, Rays
from nerfreg.rays.patches import adjacent_pixels, patch_neighbors, patch_pixels
from nerfreg.rays.traversal import occupied_runs
from nerfreg.rays.unseen import poses_between
from nerfreg.scenes.clipping import clip_to_box
from nerfreg.scenes.scene import Scene

ChoosePoses = Callable[[int], tuple[Float[Tensor, "cameras 3 4"], Int[Tensor, " cameras"]] | None]
"""Returns as many camera poses as are asked for, and the training views (numbered from 0) whose
intrinsics they have; None leaves the choice to the core."""


class _Part(NamedTuple):
    """Rays of one kind.

    Attributes:
        origins: Origins, `(R, 3)`.
        directions: Unit directions, `(R, 3)`.
        view: The training view of each ray, `(R,)`, -1 for unseen ones.
        point: The point of its image, `(R, 2)`, NaN for unseen ones.
    """

    origins: Float[Tensor, "rays 3"]
    directions: Float[Tensor, "rays 3"]
    view: Int[Tensor, " rays"]
    point: Float[Tensor, "rays 2"]


class RayBatches:
    """Draws batches of `count` rays: random training pixels, and whatever the plugins need.

    Random pixels are drawn among those whose rays meet the scene's box; nothing could be learned
    from the others. Photographs with alpha are composited on a random background per ray, so that
    empty space cannot be explained by painting the background colour.

    Attributes:
        scene: The scene whose training views are used.
        count: Rays of a step, not counting extra neighbours.
        device: Where the rays are needed.
        generator: Source of all random choices, on the CPU.
        views: View numbers of the training images, `(V,)`.
        photographs: The training images and their cameras.
        known_depth: Distances between which a plugin knows that there is something, for each
            training pixel, `(V, H, W, 2)`; None if no plugin knows any.
        data: What plugins prepared for each training pixel, `(V, H, W, ...)` by name.
        pixels: (image, x, y) of the pixels to draw from, `(useful, 3)`.
    """

    def __init__(
        self, scene: Scene, count: int, device: torch.device, generator: torch.Generator
    ) -> None:
        """Read the photographs and find the pixels to draw from."""
        self.scene = scene
        self.count = count
        self.device = device
        self.generator = generator
        self.views = torch.tensor(scene.train)
        self.photographs = scene.photographs()
        self.known_depth: Float[Tensor, "views height width 2"] | None = None
        self.data: dict[str, Tensor] = {}
        self.pixels = self._useful_pixels()

    def draw(self, needs: Needs, choose: ChoosePoses | None = None) -> Rays:
        """Draw the rays of one step: pixels, then patches, extra neighbours and unseen views.

        Patches and unseen rays take the place of random pixels, so that a step costs no more; only
        extra neighbours come on top.

        Args:
            needs: What the active plugins need.
            choose: Chooses the poses of unseen rays; None: they lie between two training views.

        Returns:
            The rays, on the device.

        Raises:
            NerfregError: If no ray with a photograph is left, or a patch does not fit.
        """
        # All random numbers of a step come from one generator on the CPU and in a fixed order, so
        # that a seed gives the same rays on any device. Moving a draw changes every run.
        side = max(needs.patch_size, 2 if needs.neighbors == "patch" else 0)
        unseen_patches = (
            self._patch_count(self.count, side, needs.unseen_patches) if needs.unseen_patches else 0
        )
        # The patches count as unseen rays; single rays fill up what they leave of the share.
        unseen_count = max(round(self.count * needs.unseen_rays), unseen_patches * side**2)
        supervised = self.count - unseen_count
        if supervised < 1:
            raise NerfregError(
                f"unseen_rays={needs.unseen_rays}, unseen_patches={needs.unseen_patches}: "
                f"no ray of train.rays={self.count} is left for the photographs; lower the shares"
            )
        wanted = needs.patch_fraction or needs.neighbors == "patch"
        patches = self._patch_count(supervised, side, needs.patch_fraction) if wanted else 0
        singles = supervised - patches * side**2
        image, pixel = self._random_pixels(singles)
        # Groups number the rays that share their distances t: each single pixel is a group of its
        # own, to which an extra neighbour may come, and a patch is one group.
        groups = [torch.arange(singles)]
        neighbors = []
        if patches:
            patch_image, patch_pixel = self._random_patches(patches, side)
            image, pixel = torch.cat([image, patch_image]), torch.cat([pixel, patch_pixel])
            groups.append(singles + torch.arange(patches).repeat_interleave(side**2))
            if needs.neighbors != "none":
                neighbors.append(singles + patch_neighbors(patches, side, self.generator))
        parts = [_Part(*self.scene.cameras.rays(self.views[image], pixel), image, pixel + 0.5)]
        # Only single pixels get an extra neighbour: those in patches have theirs already. These
        # rays come behind all that have a photograph, so that targets belong to the first rays.
        if needs.neighbors == "extra":
            parts.append(self._neighbor_rays(image[:singles], pixel[:singles]))
            groups.append(torch.arange(singles))
            neighbors.append(
                torch.stack([torch.arange(singles), supervised + torch.arange(singles)], dim=1)
            )
        unseen = unseen_views = None
        if unseen_count:
            unseen = sum(len(part.view) for part in parts) + torch.arange(unseen_count)
            cameras = unseen_patches, unseen_count - unseen_patches * side**2
            found = [
                self._unseen_rays(count, width, choose)
                for count, width in zip(cameras, (side, 1), strict=True)
            ]
            parts += [part for part, _ in found]
            unseen_views = torch.cat([views for _, views in found])
            # Nothing compares unseen rays sample by sample, so each samples for itself.
            groups.append(singles + patches + torch.arange(unseen_count))
        origins, directions, view, points = map(torch.cat, zip(*parts, strict=True))
        near, far = clip_to_box(
            origins, directions, self.scene.box, self.scene.near, self.scene.far
        )
        targets, background = self._targets(image, pixel, len(origins))
        rays = Rays(
            origins=origins,
            directions=directions,
            near=near,
            far=far,
            targets=targets,
            target_weights=_patches_as_pixels(singles, patches, side) if patches else None,
            background=background,
            patches=singles + torch.arange(patches * side**2).view(patches, side, side)
            if patches
            else None,
            neighbors=torch.cat(neighbors) if neighbors else None,
            unseen=unseen,
            unseen_patches=None
            if unseen is None or not unseen_patches
            else _squares(unseen, unseen_patches, side),
            # Patches without neighbours are compared by depth alone, for which every ray may
            # have its own t.
            groups=torch.cat(groups) if neighbors else None,
            known_depth=self.known_depth[image, pixel[:, 1], pixel[:, 0]]
            if self.known_depth is not None
            else None,
            view=view,
            pixel=points,
            unseen_views=unseen_views,
            data={
                name: values[image, pixel[:, 1], pixel[:, 0]] for name, values in self.data.items()
            },
        )
        return rays if self.device.type == "cpu" else rays.to(self.device)

    def keep_what_meets(self, grid: OccupancyGrid) -> None:
        """Leave out pixels whose rays meet no occupied cell of a grid: they are empty for certain.

        Args:
            grid: The cells.

        Raises:
            NerfregError: No pixel is left.
        """
        kept = []
        for image, view in enumerate(self.views):
            pixels = self.pixels[self.pixels[:, 0] == image]
            rays = self.scene.cameras.rays(view.expand(len(pixels)), pixels[:, 1:])
            bounds = clip_to_box(*rays, self.scene.box, self.scene.near, self.scene.far)
            kept.append(pixels[occupied_runs(grid, *rays, *bounds).met(len(pixels))])
        self.pixels = torch.cat(kept)
        if len(self.pixels) == 0:
            raise NerfregError(
                f"scene {self.scene.name}: plugins declare all space empty that training views see"
            )

    def _patch_count(self, supervised: int, side: int, fraction: float) -> int:
        """Number of patches that make up this share of the rays: at least one."""
        # A plugin may ask for a share of patches and leave their size to another.
        if side == 0:
            return 0
        if side**2 > supervised:
            raise NerfregError(
                f"train.rays={self.count}: too few for a patch of {side} x {side} pixels"
            )
        return max(1, int(supervised * fraction / side**2))

    def _useful_pixels(self) -> Int[Tensor, "useful 3"]:
        """Find (image, x, y) of all training pixels whose rays meet the box, `(useful, 3)`."""
        width, height = self.scene.cameras.width, self.scene.cameras.height
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        pixel = torch.stack([x, y], dim=-1).view(-1, 2)
        useful = []
        for image, view in enumerate(self.views):
            origins, directions = self.scene.cameras.rays(view.expand(len(pixel)), pixel)
            near, far = clip_to_box(
                origins, directions, self.scene.box, self.scene.near, self.scene.far
            )
            hit = far > near
            if self.photographs.valid is not None:
                hit &= self.photographs.valid[image].flatten()
            hit = pixel[hit]
            useful.append(torch.cat([torch.full((len(hit), 1), image), hit], dim=1))
        pixels = torch.cat(useful)
        if len(pixels) == 0:
            raise NerfregError(
                f"scene {self.scene.name}: no ray of a training view meets scene.box; "
                "check the poses"
            )
        # Half the memory: this is one row per training pixel.
        return pixels.to(torch.int32)

    def _random_pixels(self, count: int) -> tuple[Int[Tensor, " rays"], Int[Tensor, "rays 2"]]:
        chosen = self.pixels[
            torch.randint(len(self.pixels), (count,), generator=self.generator)
        ].long()
        return chosen[:, 0], chosen[:, 1:]

    def _random_patches(
        self, count: int, side: int
    ) -> tuple[Int[Tensor, " rays"], Int[Tensor, "rays 2"]]:
        """Draw patches around random useful pixels, moved to lie inside the image."""
        limit = torch.tensor([self.scene.cameras.width, self.scene.cameras.height]) - side
        if limit.min() < 0:
            raise NerfregError(
                f"patch_size {side} is larger than the images of scene {self.scene.name}"
            )
        image, pixel = self._random_pixels(count)
        corners = torch.minimum((pixel - side // 2).clamp_min(0), limit)
        return image.repeat_interleave(side**2), patch_pixels(corners, side).view(-1, 2)

    def _targets(
        self, image: Tensor, pixel: Tensor, rays: int
    ) -> tuple[Float[Tensor, "supervised 3"], Float[Tensor, "rays 3"] | None]:
        """Colours of pixels and, with alpha, the random background of every ray behind them."""
        colors = self.photographs.images[image, pixel[:, 1], pixel[:, 0]]
        if not self.scene.has_alpha:
            return colors, None
        # For rays without a photograph, too: where they are empty they show the background.
        background = torch.rand(rays, 3, generator=self.generator)
        return torch.lerp(background[: len(colors)], colors[:, :3], colors[:, 3:]), background

    def _neighbor_rays(self, image: Tensor, pixel: Tensor) -> _Part:
        """Rays through one of the four neighbours of each pixel."""
        cameras = self.scene.cameras
        beside = adjacent_pixels(pixel, cameras.width, cameras.height, self.generator)
        return _Part(*cameras.rays(self.views[image], beside), image, beside + 0.5)

    def _unseen_rays(
        self, count: int, side: int, choose: ChoosePoses | None
    ) -> tuple[_Part, Int[Tensor, " rays"]]:
        """Rays through random patches of cameras of their own, and whose intrinsics these have."""
        cameras, cpu = self.scene.cameras, self.generator
        chosen = choose(count) if choose is not None and count else None
        poses, base = self._between(count) if chosen is None else chosen
        size = torch.tensor([cameras.width, cameras.height])
        corners = (torch.rand(count, 2, generator=cpu) * (size - side + 1)).long()
        view = self.views[base]
        apart = dataclasses.replace(
            cameras,
            poses=poses,
            focal=cameras.focal[view],
            center=cameras.center[view],
            distortion=cameras.distortion[view],
        )
        camera = torch.arange(count).repeat_interleave(side**2)
        rays = apart.rays(camera, patch_pixels(corners, side).view(-1, 2))
        nowhere = torch.full((len(camera), 2), torch.nan)
        return _Part(*rays, torch.full_like(camera, -1), nowhere), base[camera]

    def _between(self, count: int) -> tuple[Float[Tensor, "cameras 3 4"], Int[Tensor, " cameras"]]:
        """Poses between two training views, and the first one of each pair."""
        cameras, cpu = self.scene.cameras, self.generator
        views = len(self.views)
        chosen = torch.randint(views, (count,), generator=cpu)
        # An offset of 1 to V - 1 makes the second camera another one, uniformly. With a single
        # view the two are the same, and so is the pose between them.
        other = (chosen + 1 + torch.randint(max(views - 1, 1), (count,), generator=cpu)) % views
        first, second = cameras.poses[self.views[chosen]], cameras.poses[self.views[other]]
        # The box is the cube around the point that the cameras of an orbit look at.
        center = self.scene.box.mean(dim=0) if self.scene.around else None
        return poses_between(first, second, torch.rand(count, generator=cpu), center), chosen


def _squares(
    rays: Int[Tensor, " rays"], patches: int, side: int
) -> Int[Tensor, "patches side side"]:
    return rays[: patches * side**2].view(patches, side, side)


def _patches_as_pixels(singles: int, patches: int, side: int) -> Float[Tensor, " supervised"]:
    """Weights of single pixels and of patches behind them, whose mean is 1.

    A patch counts as one pixel. Its rays are correlated: with equal weights, the gradient noise of
    one pixel would count `side**2` times, which cost 2 dB on the procedural scene after 300 steps
    with a quarter of the batch in patches.
    """
    weights = torch.ones(singles + patches * side**2)
    weights[singles:] /= side**2
    return weights / weights.mean()
