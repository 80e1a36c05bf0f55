"""A batch of rays with what a field said about them: all that a case consists of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nerfreg.hooks import Rays

DTYPES = {
    "float32": torch.float32,
    "float64": torch.float64,
    "bfloat16": torch.bfloat16,
    "float16": torch.float16,
}


@dataclass(frozen=True)
class Inputs:
    """Rays, and density (R, N), colours (R, N, 3) and intervals (R, N+1) on them, before they are composited.

    features: (R, N, 4) what the small networks get that a rendering is rendered again with.
    bounds: near and far of the scene.
    """

    rays: Rays
    density: Float[Tensor, "rays samples"]
    colors: Float[Tensor, "rays samples 3"]
    t_edges: Float[Tensor, "rays edges"]
    features: Float[Tensor, "rays samples 4"]
    bounds: tuple[float, float]

    @property
    def t(self) -> Float[Tensor, "rays samples"]:
        """Where the field is evaluated: the middle of each interval."""
        return torch.lerp(self.t_edges[:, :-1], self.t_edges[:, 1:], 0.5)

    def to(self, dtype: torch.dtype) -> Inputs:
        """The same numbers, rounded."""
        return _mapped(self, lambda values: values.to(dtype))

    def fits(self, dtype: torch.dtype) -> bool:
        """Whether rounding makes no number infinite."""
        return all(
            bool(tensor.to(dtype).isfinite().all()) for tensor in (self.density, self.t_edges)
        )

    def scaled(self, factor: float) -> Inputs:
        """All distances, origins among them, times `factor`; density per distance accordingly."""
        rays = replace(
            self.rays,
            origins=self.rays.origins * factor,
            near=self.rays.near * factor,
            far=self.rays.far * factor,
            known_depth=None if self.rays.known_depth is None else self.rays.known_depth * factor,
        )
        near, far = self.bounds
        bounds = near * factor, far * factor
        return replace(
            self,
            rays=rays,
            density=self.density / factor,
            t_edges=self.t_edges * factor,
            bounds=bounds,
        )

    def permuted(self, generator: torch.Generator) -> Inputs:
        """The same rays in another order; those with a target still come first."""
        supervised, rest = len(self.rays.targets), len(self.rays) - len(self.rays.targets)
        seen = torch.randperm(supervised, generator=generator)
        return self._arranged(
            [torch.cat([seen, supervised + torch.randperm(rest, generator=generator)])]
        )

    def repeated(self, times: int) -> Inputs:
        """Every ray, patch, pair and unseen ray several times."""
        return self._arranged([torch.arange(len(self.rays))] * times)

    def _arranged(self, orders: Sequence[Int[Tensor, " rays"]]) -> Inputs:
        """One copy of the batch in each of the orders; indices follow their rays."""
        supervised, count, copies = len(self.rays.targets), len(self.rays), len(orders)
        order = torch.cat([*(o[:supervised] for o in orders), *(o[supervised:] for o in orders)])
        at, rest = torch.arange(count), count - supervised
        places = []
        for copy, o in enumerate(orders):
            new = torch.where(
                at < supervised,
                copy * supervised + at,
                (copies - 1) * supervised + copy * rest + at,
            )
            places.append(torch.empty_like(o).scatter_(0, o, new))
        return _indexed(self, order, supervised * copies, places)


def _indexed(
    inputs: Inputs,
    order: Int[Tensor, " new"],
    supervised: int,
    places: Sequence[Int[Tensor, " rays"]],
) -> Inputs:
    """Rays picked by `order`; `places` says for each copy of the batch where each old ray went."""
    rays = inputs.rays

    def moved(indices: Tensor | None) -> Tensor | None:
        return None if indices is None else torch.cat([place[indices] for place in places])

    new = Rays(
        origins=rays.origins[order],
        directions=rays.directions[order],
        near=rays.near[order],
        far=rays.far[order],
        targets=rays.targets[order[:supervised]],
        background=None if rays.background is None else rays.background[order],
        patches=moved(rays.patches),
        neighbors=moved(rays.neighbors),
        unseen=moved(rays.unseen),
        unseen_patches=moved(rays.unseen_patches),
        known_depth=None if rays.known_depth is None else rays.known_depth[order[:supervised]],
    )
    pick = partial(torch.index_select, dim=0, index=order)
    return Inputs(
        new,
        pick(inputs.density),
        pick(inputs.colors),
        pick(inputs.t_edges),
        pick(inputs.features),
        inputs.bounds,
    )


def _mapped(inputs: Inputs, change: Callable[[Tensor], Tensor]) -> Inputs:
    """Every floating point tensor changed."""
    rays = {field.name: getattr(inputs.rays, field.name) for field in fields(inputs.rays)}
    changed = {
        name: change(value)
        for name, value in rays.items()
        if isinstance(value, Tensor) and value.is_floating_point()
    }
    return replace(
        inputs,
        rays=replace(inputs.rays, **changed),
        density=change(inputs.density),
        colors=change(inputs.colors),
        t_edges=change(inputs.t_edges),
        features=change(inputs.features),
    )
