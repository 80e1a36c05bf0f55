"""Calling the selected plugins: order, windows, weights, conflicts, and nothing at all."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import pytest
import torch
from torch import nn

from nerfreg import Needs, NerfregError, Regularizer, hookimpl
from nerfreg.errors import PluginError
from nerfreg.field.layers import Linear
from nerfreg.hooks import DensitySamples, EvaluatedView, OccupancyGrid, Samples
from nerfreg.registry import Hooks
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.scene import Photographs


@dataclass
class Constant(Regularizer):
    """A loss term of 3, on patches of side 4."""

    calls: list[int] = field(default_factory=list)

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        return Needs(patch_size=4)

    @hookimpl
    def nerfreg_loss(self, step) -> dict[str, torch.Tensor]:
        self.calls.append(step.index)
        return {"constant": torch.tensor(3.0)}


@dataclass
class Affine(Regularizer):
    """far becomes factor * far + offset."""

    factor: float = 1.0
    offset: float = 0.0

    @hookimpl(wrapper=True)
    def nerfreg_ray_bounds(self):
        near, far = yield
        return near, far * self.factor + self.offset


@dataclass
class Layers(Regularizer):
    """Identity layers in the network `network`."""

    network: str = "density"

    @hookimpl
    def nerfreg_layer(self, network):
        return nn.Identity() if network == self.network else None


@dataclass
class Wrapped(Regularizer):
    """Puts every layer into a sequence."""

    @hookimpl(wrapper=True)
    def nerfreg_layer(self):
        layer = yield
        return nn.Sequential(layer)


@dataclass
class Loner(Regularizer):
    """Gets along with nobody called constant."""

    conflicts: ClassVar[tuple[str, ...]] = ("constant",)


def test_nothing_selected_never_enters_pluggy(
    rays, rendering, step, monkeypatch: pytest.MonkeyPatch
) -> None:
    hooks = Hooks()

    def fail(*_: object, **__: object) -> None:
        raise AssertionError("a plugin manager was asked for")

    monkeypatch.setattr(hooks, "_manager", fail)
    samples = Samples(torch.zeros(2, 1, 3), rays.directions, torch.zeros(2, 1))
    assert hooks.needs(step(index=0)) == Needs()
    assert hooks.ray_bounds(rays, step(index=0)) == (rays.near, rays.far)
    assert hooks.encoder_input(samples, step(index=0)) is samples
    assert hooks.losses(rendering(opacity=torch.ones(1)), step(index=0)) == []
    layer = hooks.layer("density", 0, 3, 4, "relu")
    assert isinstance(layer, Linear)
    assert (layer.weight.shape, layer.activation) == ((4, 3), "relu")


def test_terms_carry_plugin_name_and_weight(rendering, step) -> None:
    hooks = Hooks({"one": Constant(weight=0.5), "two": Constant(weight=2.0)})
    terms = hooks.losses(rendering(opacity=torch.ones(1)), step(index=0))
    assert [(t.plugin, t.name, t.weight, t.value.item()) for t in terms] == [
        ("one", "constant", 0.5, 3.0),
        ("two", "constant", 2.0, 3.0),
    ]


def test_weight_zero_is_never_called_nor_rendered_for(rendering, step) -> None:
    off = Constant(weight=0.0)
    hooks = Hooks({"off": off})
    assert hooks.losses(rendering(opacity=torch.ones(1)), step(index=0)) == []
    assert hooks.needs(step(index=0)) == Needs()
    assert off.calls == []


def test_window_opens_and_closes(rendering, step) -> None:
    early, late = Constant(end=2), Constant(start=0.02)
    hooks = Hooks({"early": early, "late": late})
    for index in range(4):
        hooks.losses(rendering(opacity=torch.ones(1)), step(index=index))
    assert (early.calls, late.calls) == ([0, 1], [2, 3])


def test_needs_are_those_of_the_active(step) -> None:
    hooks = Hooks({"late": Constant(start=50)})
    assert hooks.needs(step(index=49)) == Needs()
    assert hooks.needs(step(index=50)) == Needs(patch_size=4)


def test_later_wrapper_goes_around_the_earlier(rays, step) -> None:
    # far = 3: first doubled, then one added, or the other way round
    hooks = Hooks({"double": Affine(factor=2.0), "add": Affine(offset=1.0)})
    assert hooks.ray_bounds(rays, step(index=0))[1].tolist() == [7.0, 7.0]
    hooks = Hooks({"add": Affine(offset=1.0), "double": Affine(factor=2.0)})
    assert hooks.ray_bounds(rays, step(index=0))[1].tolist() == [8.0, 8.0]


def test_wrapper_outside_its_window_is_skipped(rays, step) -> None:
    hooks = Hooks({"double": Affine(factor=2.0, end=1), "add": Affine(offset=1.0)})
    assert hooks.ray_bounds(rays, step(index=0))[1].tolist() == [7.0, 7.0]
    assert hooks.ray_bounds(rays, step(index=1))[1].tolist() == [4.0, 4.0]


def test_layers_are_replaced_and_wrapped_whatever_the_window() -> None:
    hooks = Hooks({"layers": Layers(start=50), "wrapped": Wrapped()})
    replaced, own = hooks.layer("density", 0, 2, 2, "relu"), hooks.layer("color", 0, 2, 2, "relu")
    assert isinstance(replaced, nn.Sequential) and isinstance(replaced[0], nn.Identity)
    assert isinstance(own, nn.Sequential) and isinstance(own[0], Linear)


def test_term_that_is_no_scalar_is_refused(rendering, step) -> None:
    @dataclass
    class Forgot(Regularizer):
        @hookimpl
        def nerfreg_loss(self, rendering):
            return {"forgot": rendering.opacity}

    with pytest.raises(
        NerfregError,
        match=r"plugin forgot \(.*\), nerfreg_loss at step 0: term 'forgot' has shape \(2,\)",
    ):
        Hooks({"forgot": Forgot()}).losses(rendering(opacity=torch.ones(2)), step(index=0))


@pytest.mark.parametrize(
    ("plugin", "message"),
    [
        (Constant(weight=-1.0), r"reg.x.weight=-1.0: must be finite and not negative"),
        (Constant(weight=float("nan")), r"reg.x.weight=nan"),
        (Constant(weight=float("inf")), r"reg.x.weight=inf"),
        (Constant(start=-1), r"reg.x.start=-1: must be a step"),
        (Constant(end=1.5), r"reg.x.end=1.5: must be a step"),
        (Constant(start=float("nan")), r"reg.x.start=nan"),
        (Constant(start=0.5, end=0.5), r"reg.x.start=0.5: must be before reg.x.end=0.5"),
        (Constant(start=9, end=3), r"reg.x.start=9: must be before"),
    ],
)
def test_weights_and_windows_that_cannot_work(plugin: Regularizer, message: str) -> None:
    with pytest.raises(NerfregError, match=message):
        Hooks({"x": plugin})


def test_conflict_names_both_in_either_order() -> None:
    plugins: dict[str, Regularizer] = {"loner": Loner(), "constant": Constant()}
    for order in (plugins, dict(reversed(plugins.items()))):
        with pytest.raises(NerfregError, match="reg=loner cannot be combined with reg=constant"):
            Hooks(order)


def test_argument_that_the_core_does_not_pass_is_refused() -> None:
    @dataclass
    class Greedy(Regularizer):
        @hookimpl
        def nerfreg_loss(self, rendering, images):
            return {}

    with pytest.raises(NerfregError, match=r"plugin greedy: .*images"):
        Hooks({"greedy": Greedy()})


@dataclass
class Depth(Regularizer):
    """Says that there is something between two distances everywhere, or nothing."""

    first: float = 1.0
    last: float = 2.0
    silent: bool = False
    pixels: int = 2

    @hookimpl
    def nerfreg_known_depth(self, photographs):
        return (
            None
            if self.silent
            else torch.tensor([self.first, self.last]).expand(3, 4, self.pixels, 2)
        )


@dataclass
class Shade(Regularizer):
    """Prepares the same number for each pixel."""

    factor: float = 1.0

    @hookimpl
    def nerfreg_prepare(self, photographs):
        return {"shade": torch.full(photographs.images.shape[:3], self.factor)}


@pytest.fixture
def photographs() -> Photographs:
    cameras = Cameras(
        2, 4, torch.eye(3, 4).repeat(3, 1, 1), torch.ones(3, 2), torch.ones(3, 2), torch.zeros(3, 5)
    )
    return Photographs(
        cameras=cameras,
        images=torch.rand(3, 4, 2, 3),
        box=torch.tensor([[-3.0] * 3, [3.0] * 3]),
        near=0.5,
        far=3.0,
        layout="forward",
    )


def test_depth_of_several_plugins_is_what_they_agree_on(photographs) -> None:
    assert Hooks().known_depth(photographs) is None
    assert Hooks({"silent": Depth(silent=True)}).known_depth(photographs) is None
    assert Hooks({"off": Depth(weight=0.0)}).known_depth(photographs) is None
    known = Hooks({"silent": Depth(silent=True), "late": Depth(start=0.5)}).known_depth(photographs)
    assert known.shape == (3, 4, 2, 2) and known[0, 0, 0].tolist() == [1.0, 2.0]
    nothing = Depth(first=float("nan"), last=float("nan"))

    def agreed(*plugins: Depth) -> list[float]:
        known = Hooks({str(place): p for place, p in enumerate(plugins)}).known_depth(photographs)
        return known[0, 0, 0].tolist()

    assert agreed(Depth(), Depth(first=1.5, last=3.0)) == [1.5, 2.0]
    # Nothing in common: the narrower one, in either order.
    assert agreed(Depth(first=1.0, last=2.0), Depth(first=2.5, last=3.0)) == [2.5, 3.0]
    assert agreed(Depth(first=2.5, last=3.0), Depth(first=1.0, last=2.0)) == [2.5, 3.0]
    # Intervals that touch have one distance in common.
    assert agreed(Depth(), Depth(first=2.0, last=3.0)) == [2.0, 2.0]
    assert agreed(nothing, Depth()) == agreed(Depth(), nothing) == [1.0, 2.0]


def test_instances_of_a_plugin_find_what_each_has_prepared(photographs) -> None:
    plugins = {"shade": Shade(), "shade@dark": Shade(factor=0.5)}
    data = Hooks(plugins).prepare(photographs)
    assert {name: float(values.max()) for name, values in data.items()} == {
        "shade.shade": 1.0,
        "shade@dark.shade": 0.5,
    }
    for plugin in plugins.values():
        assert float(data[f"{plugin.instance}.shade"].max()) == plugin.factor
    assert [fresh.instance for fresh in Hooks(plugins).fresh().plugins.values()] == [*plugins]
    assert Shade.instance == ""


def test_depth_of_a_wrong_kind_is_refused(photographs) -> None:
    with pytest.raises(
        NerfregError,
        match=r"wide \(.*\), nerfreg_known_depth: has shape \(3, 4, 5, 2\), not \(3, 4, 2, 2\)",
    ):
        Hooks({"wide": Depth(pixels=5)}).known_depth(photographs)
    with pytest.raises(
        NerfregError,
        match=r"plugin turned \(.*\), nerfreg_known_depth: some intervals end before they begin",
    ):
        Hooks({"turned": Depth(first=3.0)}).known_depth(photographs)
    assert Hooks({"off": Depth(weight=0.0), "on": Depth(), "other": Constant()}).preparing == (
        "on",
    )
    unknown = Hooks({"unknown": Depth(first=float("nan"), last=float("nan"))}).known_depth(
        photographs
    )
    assert unknown.isnan().all()


def answering(hook: str, answer: object) -> Hooks:
    """Hooks of a plugin that gives this answer."""
    body = {hook: hookimpl(lambda self: answer), "__doc__": "Answers."}
    plugin = dataclass(type("Answer", (Regularizer,), body))
    return Hooks({"answer": plugin()})


@pytest.mark.parametrize(
    ("hook", "answer", "message"),
    [
        ("rays", torch.zeros(2, 3), "returned Tensor; return Rays"),
        ("encoder_input", torch.zeros(2, 3), "returned Tensor; return Samples"),
        ("rendering", torch.zeros(2, 3), "returned Tensor; return Rendering"),
        ("density", [1.0], "returned list; return Tensor"),
        ("density", torch.zeros(2), r"returned shape \(2,\); return densities of shape \(2, 1\)"),
        ("ray_bounds", torch.zeros(2), "returned Tensor; return near and far"),
        ("ray_bounds", (torch.zeros(2), 1.0), r"returned shape \(2,\) and float; return near and"),
        ("needs", 4, "returned int; return Needs"),
        ("metrics", 0.5, "returned float; return numbers by name"),
    ],
)
def test_an_answer_of_another_kind_is_told(
    hook: str, answer: object, message: str, step, rays, rendering
) -> None:
    t, edges, density = torch.ones(2, 1), torch.ones(2, 2), torch.zeros(2, 1)
    color = torch.zeros(2, 1, 3)
    given = {
        "rays": rays,
        "ray_bounds": rays,
        "rendering": rendering(torch.zeros(2)),
        "encoder_input": Samples(torch.zeros(2, 1, 3), torch.zeros(2, 3), t),
        "density": DensitySamples(rays, t, edges, density, lambda: density),
        "metrics": EvaluatedView("", torch.zeros(3, 4), color, t, t, color),
    }
    arguments = [given[hook]] if hook in given else []
    hooks = answering(f"nerfreg_{hook}", answer)
    with pytest.raises(PluginError, match=rf"nerfreg_{hook} at step 7: {message}"):
        getattr(hooks, hook)(*arguments, step(7))


def test_an_edit_that_spoils_the_backward_pass_is_blamed_on_the_plugins(step) -> None:
    x = torch.ones(2, requires_grad=True)
    kept = torch.ones(2)
    product = (x * kept).sum()
    kept.mul_(0.5)
    with pytest.raises(RuntimeError) as caught:
        product.backward()
    told = Hooks({"mine": Constant()}).blamed(caught.value, step(3))
    assert isinstance(told, PluginError)
    assert "mine" in str(told) and "backward pass at step 3: a tensor" in str(told)
    assert Hooks().blamed(caught.value, step(3)) is caught.value


@pytest.mark.parametrize(
    ("hook", "answer", "message"),
    [
        ("prepare", torch.zeros(3, 4, 2), "returned Tensor; return a dictionary of tensors"),
        (
            "prepare",
            {"grey": torch.zeros(3, 4)},
            r"'grey' has shape \(3, 4\); return a tensor of shape \(3, 4, 2, ...\)",
        ),
        ("prepare", {"grey": 1.0}, "'grey' is of type float; return a tensor of shape"),
        ("known_depth", 2.0, r"returned float; return a tensor \(3, 4, 2, 2\)"),
    ],
)
def test_what_is_prepared_in_another_shape_is_told(
    hook: str, answer: object, message: str, photographs
) -> None:
    with pytest.raises(PluginError, match=message):
        getattr(answering(f"nerfreg_{hook}", answer), hook)(photographs)


@dataclass
class Cells(Regularizer):
    """Answers whatever it holds."""

    answer: object = None

    @hookimpl
    def nerfreg_occupancy(self):
        return self.answer


def cells_at(*index: int) -> OccupancyGrid:
    """Four cells of length 1 along x, of which some are occupied."""
    occupied = torch.zeros(4, 1, 1, dtype=torch.bool)
    occupied[list(index)] = True
    return OccupancyGrid(occupied, torch.zeros(3), 1.0)


def test_grids_of_all_active_plugins_are_listed(step) -> None:
    first, second = cells_at(0), cells_at(1)
    hooks = Hooks(
        {"one": Cells(answer=first), "none": Cells(), "two": Cells(answer=second, start=50)}
    )
    assert Hooks().occupancy(step(index=0)) == ()
    assert hooks.occupancy(step(index=0)) == (first,)
    assert hooks.occupancy(step(index=50)) == (first, second)


def test_what_lies_outside_of_any_grid_is_empty(step) -> None:
    positions = torch.tensor([[0.5, 0.0, 0.0], [1.5, 0.0, 0.0], [2.5, 0.0, 0.0]])
    hooks = Hooks({"one": Cells(answer=cells_at(0, 1)), "two": Cells(answer=cells_at(1, 2))})
    empty = hooks.empty(positions, step(index=0))
    assert empty is not None and empty.tolist() == [True, False, True]
    assert Hooks({"none": Cells()}).empty(positions, step(index=0)) is None


def test_an_answer_that_is_no_grid_is_refused(step) -> None:
    hooks = Hooks({"cells": Cells(answer=torch.ones(4, 4, 4, dtype=torch.bool))})
    with pytest.raises(
        PluginError,
        match=r"cells.*, nerfreg_occupancy at step 3: returned Tensor; return an OccupancyGrid",
    ):
        hooks.occupancy(step(index=3))
