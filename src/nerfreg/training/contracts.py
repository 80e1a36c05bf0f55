"""What is wrong with the answer of a hook: one line for each mistake, none if nothing is wrong."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cached_property

import torch
from torch import Tensor, nn

from nerfreg.field.layers import AffineLayer
from nerfreg.hooks import (
    NEIGHBORS,
    ColorSamples,
    DensitySamples,
    Needs,
    Rays,
    Rendering,
    Samples,
)
from nerfreg.numerics import not_finite
from nerfreg.scenes.scene import SceneInfo


def wrong_known_depth(known: Tensor) -> list[str]:
    """Check that `nerfreg_known_depth` tells both ends of an interval, (..., 2), or neither.

    The nearer one is not behind the camera, and the farther one is finite.
    """
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


def wrong_needs(needs: object) -> list[str]:
    """Check that `nerfreg_needs` returned None, or a `Needs` that the core can render."""
    if needs is None:
        return []
    if not isinstance(needs, Needs):
        return [f"returned {kind(needs)}, not a Needs"]
    share = "at least 0 and below 1"
    demands = {
        "patch_size": (
            isinstance(needs.patch_size, int) and needs.patch_size >= 0,
            "an integer, at least 0",
        ),
        "patch_fraction": (0 <= needs.patch_fraction <= 1, "between 0 and 1"),
        "unseen_rays": (0 <= needs.unseen_rays < 1, share),
        "unseen_patches": (0 <= needs.unseen_patches < 1, share),
        "neighbors": (needs.neighbors in NEIGHBORS, f"one of {', '.join(NEIGHBORS)}"),
    }
    return [
        f"{key}={getattr(needs, key)!r}: must be {demand}"
        for key, (met, demand) in demands.items()
        if not met
    ]


def wrong_bounds(near: object, far: object, rays: Rays) -> list[str]:
    """Check that near and far of `nerfreg_ray_bounds` are (R,), finite and in order."""
    wrong = unlike("near", near, rays.near) + unlike("far", far, rays.far)
    if wrong or not (isinstance(near, Tensor) and isinstance(far, Tensor)):
        return wrong
    beyond = (near.detach() > far.detach()).nonzero()
    if len(beyond) == 0:
        return []
    ray = int(beyond[0])
    return [
        f"near > far on {len(beyond)} of {len(near)} rays, the first ray {ray}: "
        f"near {float(near[ray]):g}, far {float(far[ray]):g}"
    ]


def wrong_samples(before: Samples, after: object) -> list[str]:
    """Check what `nerfreg_encoder_input` made of `before`.

    It must have the same shapes, be finite, and ask for no more features than there are.
    """
    if not isinstance(after, Samples):
        return [f"returned {kind(after)}, not Samples; return `samples` to leave them as they are"]
    wrong = unlike("positions", after.positions, before.positions)
    wrong += unlike("t", after.t, before.t)
    # Directions may come as (R, 3), and go on as (R, N, 3).
    per_sample = isinstance(after.directions, Tensor) and after.directions.ndim == 3
    model = before.positions if per_sample else before.directions
    wrong += unlike("directions", after.directions, model)
    for side in ("density", "color"):
        width, left = getattr(before, f"{side}_width"), getattr(after, f"{side}_width")
        active = getattr(after, f"{side}_features")
        if active is not None and not 0 <= active <= width:
            wrong.append(f"{side}_features={active!r}: must be None, or between 0 and {width}")
        if left != width:
            wrong.append(f"{side}_width={left!r}: is the core's, {width}; leave it")
    return wrong


def wrong_terms(terms: object, dtype: torch.dtype | None = None) -> list[str]:
    """Check that the terms of `nerfreg_loss`, by name, are finite scalars.

    Args:
        terms: What the hook returned.
        dtype: The type that they must have; None: any.
    """
    if not isinstance(terms, Mapping):
        return [f"returned {kind(terms)}; return a dict of terms by name, {{}} if there are none"]
    wrong = []
    for name, value in terms.items():
        if not isinstance(value, Tensor):
            wrong.append(f"term '{name}' is {kind(value)}, not a tensor")
        elif value.ndim != 0:
            wrong.append(f"term '{name}' has shape {tuple(value.shape)}, not that of a scalar")
        else:
            wrong += not_finite(f"term '{name}'", value)
            wrong += _other_precision(name, value, dtype)
    return wrong


def _other_precision(name: str, value: Tensor, dtype: torch.dtype | None) -> list[str]:
    if dtype in (None, value.dtype):
        return []
    wide = value.dtype == torch.float64
    cost = "doubles the cost of all that follows" if wide else "has too few digits for a loss"
    found, wanted = (str(given).removeprefix("torch.") for given in (value.dtype, dtype))
    return [f"term '{name}' is in {found}, the rendering in {wanted}: it {cost}; return {wanted}"]


def wrong_layer(layer: object, in_features: int, out_features: int) -> list[str]:
    """Check that a layer of `nerfreg_layer` maps (points, in) to (points, out), all finite.

    Its parameters must be finite, too. It is tried on two points, one of zeros and one of ones; an
    `AffineLayer` also by its effective weight and bias.
    """
    if not isinstance(layer, nn.Module):
        return [f"returned {kind(layer)}, not a torch module"]
    wrong = [line for name, values in layer.named_parameters() for line in not_finite(name, values)]
    probe = torch.stack([torch.zeros(in_features), torch.ones(in_features)])
    try:
        # A layer that draws numbers must not change those that the next layer starts with.
        with torch.no_grad(), torch.random.fork_rng(devices=[]):
            output = layer(probe)
            affine = layer.effective() if isinstance(layer, AffineLayer) else None
    except Exception as error:  # a foreign module may raise anything
        failure = f"fails on (points, {in_features}): {type(error).__name__}: {error}"
        return [*wrong, failure.partition("\n")[0]]
    wrong += unlike("output", output, probe.new_empty(2, out_features))
    if affine is not None:
        weight, bias = affine
        wrong += unlike("effective weight", weight, probe.new_empty(out_features, in_features))
        if bias is not None:
            wrong += unlike("effective bias", bias, probe.new_empty(out_features))
    return wrong


class Untouched:
    """Remembers the tensors that a hook gets, and tells which have been edited or replaced since.

    Values are compared besides versions, because an edit through `.data` or numpy leaves the
    version as it was. Properties that are computed once, such as `Rendering.alphas`, are compared
    with what they must be.
    """

    def __init__(
        self,
        watched: Rendering | Rays | Samples | DensitySamples | ColorSamples | SceneInfo,
    ) -> None:
        self._watched = watched
        self._tensors = dict(_tensors(watched))
        self._versions = {name: tensor._version for name, tensor in self._tensors.items()}
        self._copies = {name: tensor.detach().clone() for name, tensor in self._tensors.items()}
        self._computed = dict(_computed(watched))

    def edits(self) -> list[str]:
        """Return one line for each tensor that is not as it was."""
        now = dict(_tensors(self._watched))
        lines = []
        for name, tensor in self._tensors.items():
            if now.get(name) is not tensor:
                lines.append(f"{name} has been replaced")
            elif tensor._version != self._versions[name] or not _same(tensor, self._copies[name]):
                lines.append(f"{name} has been edited in place")
        lines += [f"{name} has been added" for name in now.keys() - self._tensors.keys()]
        cached = vars(self._watched)
        return lines + [
            f"{name} has been edited in place"
            for name, value in self._computed.items()
            if name in cached and not _same(cached[name], value)
        ]


def _tensors(watched: object, prefix: str = "") -> Iterator[tuple[str, Tensor]]:
    if is_dataclass(watched):
        parts: Iterable[tuple[str, object]] = (
            (field.name, getattr(watched, field.name)) for field in fields(watched)
        )
    else:
        parts = watched.items() if isinstance(watched, Mapping) else ()
    for name, value in parts:
        if isinstance(value, Tensor):
            yield prefix + name, value
        elif is_dataclass(value) or isinstance(value, Mapping):
            yield from _tensors(value, f"{prefix}{name}.")


@torch.no_grad()
def _computed(watched: object) -> Iterator[tuple[str, Tensor]]:
    # Those of a rendering alone: the raw densities of DensitySamples cost an evaluation, which a
    # hook that does not ask for them does without.
    for name, value in vars(type(watched)).items() if isinstance(watched, Rendering) else ():
        if isinstance(value, cached_property):
            # Not cached, and without a graph: a graph made here would change the order of later
            # sums, and a run that is looked at must train as one that is not.
            yield name, value.func(watched)


def _same(a: Tensor, b: Tensor) -> bool:
    # NaN counts as equal to NaN.
    return torch.equal(a.detach(), b) or bool(((a == b) | (a.isnan() & b.isnan())).all())


def unlike(name: str, values: object, model: Tensor) -> list[str]:
    """Check that `values` are a finite tensor of the model's shape, dtype and device."""
    wrong = differs(name, values, model)
    return wrong or (not_finite(name, values) if isinstance(values, Tensor) else [])


def differs(name: str, values: object, model: Tensor) -> list[str]:
    """Check that `values` are a tensor of the model's shape, dtype and device."""
    if not isinstance(values, Tensor):
        return [f"{name}: is {kind(values)}, not a tensor"]
    for what in ("shape", "dtype", "device"):
        found, wanted = getattr(values, what), getattr(model, what)
        if found != wanted:
            pair = (tuple(found), tuple(wanted)) if what == "shape" else (found, wanted)
            return [f"{name}: has {what} {pair[0]}, not {pair[1]}"]
    return []


def kind(value: object) -> str:
    """Return what a value is, in words."""
    return "None" if value is None else f"of type {type(value).__name__}"
