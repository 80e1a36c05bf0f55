"""A batch of rays with what a field said about them: all that a case consists of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nerfreg.hooks import Rays
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.scene import Photographs

DTYPES = {
    "float32": torch.float32,
    "float64": torch.float64,
    "bfloat16": torch.bfloat16,
    "float16": torch.float16,
}
DISTANCES = ("origins", "near", "far", "known_depth", "t_edges")
SUPERVISED = ("targets", "target_weights", "known_depth", "data")
"""What has one row for each ray with a photograph behind it, the first of a batch."""

INDICES = ("patches", "neighbors", "unseen", "unseen_patches")
OF_UNSEEN = ("unseen_views",)
"""What has one row for each number in `unseen`."""

PIXEL = 0.01
"""Distance of adjacent pixels, in units of the focal length."""

VIEWS = 2
SIDE = 4
"""Views, and pixels along both sides of an image."""

Part = TypeVar("Part")


def with_tensors(part: Part, change: Callable[[str, Tensor], Tensor]) -> Part:
    """Copy a dataclass and those inside it, with every tensor changed, given its field's name.

    The tensors of a mapping are changed by the name of the field that holds it.
    """
    given: Any = part  # no type says that it is a dataclass
    changed: dict[str, Any] = {}
    for name in (field.name for field in fields(given)):
        value = getattr(given, name)
        if isinstance(value, Tensor):
            changed[name] = change(name, value)
        elif isinstance(value, Mapping):
            changed[name] = {key: change(name, part) for key, part in value.items()}
        elif is_dataclass(value):
            changed[name] = with_tensors(value, change)
    copy: Part = replace(given, **changed)
    return copy


def cast(part: Part, dtype: torch.dtype) -> Part:
    """Copy a dataclass and those inside it, with every floating point tensor rounded."""
    return with_tensors(part, lambda _, x: x.to(dtype) if x.is_floating_point() else x)


def cast_to(values: Tensor, inputs: Inputs) -> Tensor:
    """Round values to the precision of a case if they are floating point."""
    return values.to(inputs.density.dtype) if values.is_floating_point() else values


@dataclass(frozen=True)
class Inputs:
    """Rays, and what a field says along them, before they are composited.

    Attributes:
        rays: R rays.
        density: (R, N) per world unit.
        colors: (R, N, 3) in [0, 1].
        t_edges: (R, N+1) borders of the intervals, ascending.
        features: (R, N, 4) what the driver's small networks get.
        bounds: Near and far of the scene.
    """

    rays: Rays
    density: Float[Tensor, "rays samples"]
    colors: Float[Tensor, "rays samples 3"]
    t_edges: Float[Tensor, "rays edges"]
    features: Float[Tensor, "rays samples 4"]
    bounds: tuple[float, float]

    @property
    def t(self) -> Float[Tensor, "rays samples"]:
        """Where the field is evaluated, (R, N): the middle of each interval."""
        return torch.lerp(self.t_edges[:, :-1], self.t_edges[:, 1:], 0.5)

    @property
    def photographs(self) -> Photographs:
        """Two views of `SIDE` x `SIDE` pixels of noise, the first of which the rays belong to."""
        eye, (near, far) = self.rays.origins[0].detach().float(), self.bounds
        reach = 1.5 * far
        poses = torch.eye(3, 4).repeat(VIEWS, 1, 1)
        poses[:, :, 3] = eye
        poses[1, 0, 3] += 0.1 * reach
        focal = torch.full((VIEWS, 2), 1 / PIXEL)
        # A pixel at the top left is straight ahead.
        center = torch.full((VIEWS, 2), 0.5)
        generator = torch.Generator().manual_seed(0)
        return Photographs(
            cameras=Cameras(SIDE, SIDE, poses, focal, center, torch.zeros(VIEWS, 5)),
            images=torch.rand(VIEWS, SIDE, SIDE, 3, generator=generator),
            box=torch.stack([eye - reach, eye + reach]),
            near=near,
            far=far,
            layout="forward",
            name="check",
            labels=tuple(f"train/{view}" for view in range(VIEWS)),
        )

    def with_data(self, prepared: Mapping[str, Tensor]) -> Inputs:
        """Return the same rays with what plugins prepared for their pixels.

        Args:
            prepared: Values of each pixel of `photographs`, (V, H, W, ...), by name.
        """
        rays, count = self.rays, len(self.rays.targets)
        assert rays.view is not None and rays.pixel is not None
        x, y = rays.pixel[:count].float().long().unbind(1)
        view = rays.view[:count]
        data = {name: cast_to(values[view, y, x], self) for name, values in prepared.items()}
        return replace(self, rays=replace(rays, data=data))

    def scaled(self, factor: float) -> Inputs:
        """Return the scene with all distances times `factor`, and the same optical thickness."""
        factors = dict.fromkeys(DISTANCES, factor) | {"density": 1 / factor}
        grown = with_tensors(self, lambda name, x: x * factors[name] if name in factors else x)
        near, far = self.bounds
        return replace(grown, bounds=(near * factor, far * factor))

    def permuted(self, generator: torch.Generator) -> Inputs:
        """Return the same rays in another order; those with a target still come first."""
        supervised = len(self.rays.targets)
        seen = torch.randperm(supervised, generator=generator)
        rest = torch.randperm(len(self.rays) - supervised, generator=generator)
        return self._arranged([torch.cat([seen, supervised + rest])])

    def repeated(self, times: int) -> Inputs:
        """Return every ray, patch, pair and unseen ray several times."""
        return self._arranged([torch.arange(len(self.rays))] * times)

    def joined(self, other: Inputs) -> Inputs:
        """Return one batch of these rays and as many others, which have the same shapes."""
        twice, count = self.repeated(2), len(self.rays)
        supervised = len(self.rays.targets)
        # Where the rays of the second copy are, as `_arranged` puts them.
        second = torch.arange(2 * count)
        second = torch.cat([second[supervised : 2 * supervised], second[count + supervised :]])

        def put(into: Any, part: Any) -> Any:
            changed: dict[str, Any] = {}
            for name in (field.name for field in fields(into)):
                value = getattr(into, name)
                if is_dataclass(value):
                    changed[name] = put(value, getattr(part, name))
                elif isinstance(value, Tensor) and name not in (*INDICES, *OF_UNSEEN):
                    rows = second[: len(getattr(part, name))]
                    changed[name] = value.index_copy(0, rows, getattr(part, name))
            return replace(into, **changed)

        joined: Inputs = put(twice, other)
        return joined

    def _arranged(self, orders: Sequence[Int[Tensor, " rays"]]) -> Inputs:
        """One copy of the batch in each of the orders; indices follow their rays."""
        count, supervised = len(self.rays), len(self.rays.targets)
        numbered = [order + copy * count for copy, order in enumerate(orders)]
        with_target = [order[:supervised] for order in numbered]
        order = torch.cat(with_target + [order[supervised:] for order in numbered])
        # The inverse permutation says where each ray of each copy went.
        places = order.argsort().view(len(orders), count)
        order = order % count

        def arrange(name: str, values: Tensor) -> Tensor:
            if name in INDICES:
                return torch.cat([place[values] for place in places])
            if name in OF_UNSEEN:
                return values.repeat(len(orders))
            return values[order[: supervised * len(orders)] if name in SUPERVISED else order]

        return with_tensors(self, arrange)
