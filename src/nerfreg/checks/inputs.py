"""A batch of rays with what a field said about them: all that a case consists of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar

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
DISTANCES = ("origins", "near", "far", "known_depth", "t_edges")
SUPERVISED = ("targets", "target_weights", "known_depth")
"""What has one row for each ray with a photograph behind it, the first of a batch."""

INDICES = ("patches", "neighbors", "unseen", "unseen_patches")

Part = TypeVar("Part")


def with_tensors(part: Part, change: Callable[[str, Tensor], Tensor]) -> Part:
    """Copy a dataclass and those inside it, with every tensor changed, given its field's name."""
    given: Any = part  # no type says that it is a dataclass
    changed: dict[str, Any] = {}
    for name in (field.name for field in fields(given)):
        value = getattr(given, name)
        if isinstance(value, Tensor):
            changed[name] = change(name, value)
        elif is_dataclass(value):
            changed[name] = with_tensors(value, change)
    copy: Part = replace(given, **changed)
    return copy


def cast(part: Part, dtype: torch.dtype) -> Part:
    """Copy a dataclass and those inside it, with every floating point tensor rounded."""
    return with_tensors(part, lambda _, x: x.to(dtype) if x.is_floating_point() else x)


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
            return values[order[: supervised * len(orders)] if name in SUPERVISED else order]

        return with_tensors(self, arrange)
