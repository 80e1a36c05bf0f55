"""Whether a field in evaluation is what its checkpoint says.

A plugin may leave something in force that belongs to training: a mask, a perturbation, or state
that no checkpoint holds. A run would then be scored by what nobody can load again. Therefore a few
rays are rendered twice: with the plugins that took part in the training, and with the same plugins
made anew and the checkpoint loaded into them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg.errors import PluginError
from nerfreg.evaluation.trained import TrainedField
from nerfreg.field import RadianceField
from nerfreg.field.network import Network
from nerfreg.hooks import Rays
from nerfreg.rendering.renderer import Renderer

RAYS = 64
"""How many rays are compared."""

TOLERANCE = 1e-4
"""Largest difference of colours and opacities, a fortieth of a step of 8-bit colour."""


def require_no_leak(live: TrainedField, saved: TrainedField) -> None:
    """Compare a few rays of a field that has just been trained with those of its checkpoint.

    Args:
        live: The field that has been trained, in evaluation, with the weights of the checkpoint.
        saved: The field of the checkpoint, with plugins that have taken part in nothing else.

    Raises:
        PluginError: They differ; names the plugin where it can be found out.
    """
    if not live.hooks.plugins:
        # Without a plugin there is nothing that could differ.
        return
    difference = _difference(live, saved)
    if difference <= TOLERANCE:
        return
    causes = list(dict.fromkeys(_causes(live, saved)))
    suspects = [name for name, _ in causes] or list(live.hooks.plugins)
    names = " and ".join(dict.fromkeys(suspects))
    reason = f" ({causes[0][1]})" if causes else ""
    raise PluginError(
        f"plugin {names}: evaluation right after training differs by {difference:.2g} from that of "
        f"the checkpoint{reason}; what a plugin sets for a step must be undone before the step "
        "ends, and what it learns must be part of its module or its state_dict"
    )


def _difference(live: TrainedField, saved: TrainedField) -> float:
    """Largest difference of a few rays; infinity if one of them is not a number."""
    expected = _rendered(saved)
    try:
        difference = float((_rendered(live) - expected).abs().max())
    except Exception:  # what is left in force may fit the points of a training step alone
        return math.inf
    return math.inf if math.isnan(difference) else difference


@torch.no_grad()
def _rendered(trained: TrainedField) -> Float[Tensor, "rays 4"]:
    """Colour and opacity of a few rays, spread over the views of the scene."""
    # As rays of training are rendered and not as views are, because that takes a hundredth of the
    # time: there is no occupancy grid to be made.
    renderer = Renderer(trained.field, trained.sampler, trained.hooks)
    generator = torch.Generator().manual_seed(0)
    step = replace(trained.step, generator=generator, renderer=renderer)
    made = renderer.render(renderer.cast(_rays(trained, generator), step), step)
    return torch.cat([made.rgb, made.opacity[:, None]], dim=1).cpu()


def _rays(trained: TrainedField, generator: torch.Generator) -> Rays:
    scene, cameras = trained.scene, trained.scene.cameras
    view = torch.randint(len(cameras), (RAYS,), generator=generator)
    size = torch.tensor([cameras.width, cameras.height])
    pixel = (torch.rand(RAYS, 2, generator=generator) * size).long()
    origins, directions = cameras.rays(view, pixel)
    number = {view: number for number, view in enumerate(scene.train)}
    device = trained.field.center.device
    rays = Rays(
        origins,
        directions,
        *scene.info.clipped(origins, directions),
        background=None if scene.background is None else scene.background.expand(RAYS, 3),
        view=torch.tensor([number.get(int(v), -1) for v in view]),
        pixel=pixel + 0.5,
    )
    return rays.to(device)


def _causes(live: TrainedField, saved: TrainedField) -> Iterator[tuple[str, str]]:
    """Plugins whose part of the field, or whose hook alone, differs, with what differs."""
    for part, (a, b) in _modules(live.field, saved.field):
        if not _alike(a, b):
            name = live.hooks.owner(type(a))
            if name is not None:
                yield name, part
    for name in live.hooks.plugins:
        # The plugin as it is with all others made anew; if that differs, it is this one.
        mixed = replace(saved, hooks=saved.hooks.with_plugin(name, live.hooks.plugins[name]))
        if _difference(mixed, saved) > TOLERANCE:
            yield name, "what its hooks do in evaluation"


def _modules(
    live: RadianceField, saved: RadianceField
) -> Iterator[tuple[str, tuple[nn.Module, nn.Module]]]:
    for network in ("density", "color"):
        a, b = (getattr(field, f"{network}_network") for field in (live, saved))
        assert isinstance(a, Network) and isinstance(b, Network)
        for index, pair in enumerate(zip(a.layers, b.layers, strict=True)):
            yield f"layer {index} of the {network} network", pair
    for name in ("encoder", "direction_encoder"):
        pair = getattr(live, name), getattr(saved, name)
        if isinstance(pair[0], nn.Module):
            yield name.replace("_", " "), pair


@torch.no_grad()
def _alike(a: nn.Module, b: nn.Module) -> bool:
    """Whether two modules have the same tensors and map the same points to the same values."""
    first, second = a.state_dict(), b.state_dict()
    same = all(torch.equal(value, second[name]) for name, value in first.items())
    width = getattr(a, "in_features", None)
    weights = [p for p in a.parameters() if p.dim() == 2]
    if width is None and weights:
        width = weights[0].shape[1]
    if width is None:
        width = 3
    probe = torch.rand(8, width, generator=torch.Generator().manual_seed(0))
    device = next(a.parameters(), probe).device
    try:
        outputs = a(probe.to(device)), b(probe.to(device))
    except Exception:  # a layer that keeps something of another number of points fails by that
        return False
    return same and torch.allclose(*outputs, atol=TOLERANCE)
