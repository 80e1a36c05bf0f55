"""Which numbers of a tensor are not finite."""

from __future__ import annotations

from torch import Tensor


def not_finite(name: str, values: Tensor) -> list[str]:
    """One line with how many of the values, of any shape, are not finite, and the first of them; none if all are."""
    values = values.detach()
    bad = (~values.isfinite()).nonzero()
    if len(bad) == 0:
        return []
    place = tuple(int(index) for index in bad[0])
    first = float(values[place])
    if not place:
        return [f"{name} is {first}"]
    return [
        f"{name}: {len(bad)} of {values.numel()} values not finite, the first at {list(place)}: {first}"
    ]
