"""What is wrong with the output of a hook, in one line for each mistake; no line means that nothing is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from functools import cached_property

import torch
from torch import Tensor, nn

from nerfreg.field.layers import AffineLayer
from nerfreg.hooks import NEIGHBORS, Needs, Rays, Rendering, Samples
from nerfreg.numerics import not_finite
from nerfreg.registry import Term
from nerfreg.scenes.scene import Photographs


def wrong_needs(needs: object) -> list[str]:
    """`nerfreg_needs` returns None or a Needs with a size from 0, a share up to 1, one below 1 and known names."""
    if needs is None:
        return []
    if not isinstance(needs, Needs):
        return [f"returned {_kind(needs)}, not a Needs"]
    wrong = []
    if not isinstance(needs.patch_size, int) or needs.patch_size < 0:
        wrong.append(f"patch_size={needs.patch_size!r}: must be an integer, at least 0")
    if not 0 <= needs.patch_fraction <= 1:
        wrong.append(f"patch_fraction={needs.patch_fraction!r}: must be between 0 and 1")
    if not 0 <= needs.unseen_rays < 1:
        wrong.append(f"unseen_rays={needs.unseen_rays!r}: must be at least 0 and below 1")
    if not 0 <= needs.unseen_patches < 1:
        wrong.append(f"unseen_patches={needs.unseen_patches!r}: must be at least 0 and below 1")
    if needs.neighbors not in NEIGHBORS:
        wrong.append(f"neighbors={needs.neighbors!r}: must be one of {', '.join(NEIGHBORS)}")
    return wrong


def wrong_bounds(near: object, far: object, rays: Rays) -> list[str]:
    """Near and far of `nerfreg_ray_bounds` are (R,) as those of `rays`, finite, and near is nowhere beyond far."""
    wrong = _unlike("near", near, rays.near) + _unlike("far", far, rays.far)
    if wrong or not (isinstance(near, Tensor) and isinstance(far, Tensor)):
        return wrong
    beyond = (near.detach() > far.detach()).nonzero()
    if len(beyond):
        ray = int(beyond[0])
        wrong.append(
            f"near > far on {len(beyond)} of {len(near)} rays, the first ray {ray}: "
            f"near {float(near[ray]):g}, far {float(far[ray]):g}"
        )
    return wrong


def wrong_samples(before: Samples, after: object) -> list[str]:
    """What `nerfreg_encoder_input` made of `before` has its shapes, is finite, and asks for features that exist."""
    if not isinstance(after, Samples):
        return [f"returned {_kind(after)}, not Samples"]
    wrong = _unlike("positions", after.positions, before.positions) + _unlike(
        "t", after.t, before.t
    )
    # Directions may come as (R, 3), and go on as (R, N, 3).
    per_sample = isinstance(after.directions, Tensor) and after.directions.ndim == 3
    wrong += _unlike(
        "directions", after.directions, before.positions if per_sample else before.directions
    )
    for side in ("density", "color"):
        width, active = getattr(before, f"{side}_width"), getattr(after, f"{side}_features")
        if active is not None and not 0 <= active <= width:
            wrong.append(f"{side}_features={active!r}: must be None, or between 0 and {width}")
        if getattr(after, f"{side}_width") != width:
            wrong.append(
                f"{side}_width={getattr(after, f'{side}_width')!r}: is the core's, {width}; leave it"
            )
    return wrong


def wrong_terms(terms: Sequence[Term]) -> list[str]:
    """The terms of `nerfreg_loss` are finite scalars."""
    wrong = []
    for term in terms:
        if not isinstance(term.value, Tensor):
            wrong.append(f"term '{term.name}' is {_kind(term.value)}, not a tensor")
        elif term.value.ndim != 0:
            wrong.append(
                f"term '{term.name}' has shape {tuple(term.value.shape)}, not that of a scalar"
            )
        else:
            wrong += not_finite(f"term '{term.name}'", term.value)
    return wrong


def wrong_layer(layer: object, in_features: int, out_features: int) -> list[str]:
    """A layer of `nerfreg_layer` has finite parameters and maps (points, in) to (points, out), finite.

    It is tried on two points, one of zeros and one of ones; an `AffineLayer` also by its effective weight and bias.
    """
    if not isinstance(layer, nn.Module):
        return [f"returned {_kind(layer)}, not a torch module"]
    wrong = [
        line for name, parameter in layer.named_parameters() for line in not_finite(name, parameter)
    ]
    probe = torch.stack([torch.zeros(in_features), torch.ones(in_features)])
    try:
        # A layer that draws numbers must not change those that the next layer starts with.
        with torch.no_grad(), torch.random.fork_rng(devices=[]):
            output = layer(probe)
            affine = layer.effective() if isinstance(layer, AffineLayer) else None
    except Exception as error:  # a stranger's module may raise anything
        return [
            *wrong,
            f"fails on (points, {in_features}): {type(error).__name__}: {error}".partition("\n")[0],
        ]
    wrong += _unlike("output", output, probe.new_empty(2, out_features))
    if affine is not None:
        weight, bias = affine
        wrong += _unlike("effective weight", weight, probe.new_empty(out_features, in_features))
        wrong += (
            [] if bias is None else _unlike("effective bias", bias, probe.new_empty(out_features))
        )
    return wrong


class Untouched:
    """Remembers the tensors of what a hook gets, and tells which have been edited or replaced since.

    Values are compared besides versions: an edit through `.data` or numpy leaves the version as it was. Properties
    that are computed once, such as `Rendering.alphas`, are compared with what they must be.
    """

    def __init__(self, watched: Rendering | Rays | Samples | Photographs) -> None:
        self._watched = watched
        self._tensors = dict(_tensors(watched))
        self._versions = {name: tensor._version for name, tensor in self._tensors.items()}
        self._copies = {name: tensor.detach().clone() for name, tensor in self._tensors.items()}
        self._computed = dict(_computed(watched))

    def edits(self) -> list[str]:
        """One line for each tensor that is not as it was."""
        now = dict(_tensors(self._watched))
        lines = []
        for name, tensor in self._tensors.items():
            if now.get(name) is not tensor:
                lines.append(f"{name} has been replaced")
            elif tensor._version != self._versions[name] or not _same(tensor, self._copies[name]):
                lines.append(f"{name} has been edited in place")
        lines += [f"{name} has been added" for name in now.keys() - self._tensors.keys()]
        kept = vars(self._watched)
        return lines + [
            f"{name} has been edited in place"
            for name, value in self._computed.items()
            if name in kept and not _same(kept[name], value)
        ]


def _tensors(watched: object, prefix: str = "") -> Iterator[tuple[str, Tensor]]:
    assert is_dataclass(watched)
    for field in fields(watched):
        value = getattr(watched, field.name)
        if isinstance(value, Tensor):
            yield prefix + field.name, value
        elif is_dataclass(value):
            yield from _tensors(value, f"{prefix}{field.name}.")


@torch.no_grad()
def _computed(watched: object) -> Iterator[tuple[str, Tensor]]:
    """What the cached properties give, without caching it: a graph made here would change the order of later sums."""
    for name, value in vars(type(watched)).items():
        if isinstance(value, cached_property):
            yield name, value.func(watched)


def _same(a: Tensor, b: Tensor) -> bool:
    return torch.equal(a.detach(), b) or bool(((a == b) | (a.isnan() & b.isnan())).all())


def _unlike(name: str, values: object, model: Tensor) -> list[str]:
    """What keeps `values` from being a finite tensor of the model's shape, dtype and device."""
    if not isinstance(values, Tensor):
        return [f"{name}: is {_kind(values)}, not a tensor"]
    for what in ("shape", "dtype", "device"):
        found, wanted = getattr(values, what), getattr(model, what)
        if found != wanted:
            pair = (tuple(found), tuple(wanted)) if what == "shape" else (found, wanted)
            return [f"{name}: has {what} {pair[0]}, not {pair[1]}"]
    return not_finite(name, values)


def _kind(value: object) -> str:
    return "None" if value is None else f"of type {type(value).__name__}"
