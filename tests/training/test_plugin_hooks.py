"""Hooks through a whole step: rays, densities, colours, parameters, state and evaluation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor, nn

from nerfreg import Needs, OccupancyGrid, Regularizer, Schedule, TrainedModule, hookimpl
from nerfreg.errors import PluginError
from nerfreg.evaluation.leaks import require_no_leak
from nerfreg.evaluation.scores import score_views
from nerfreg.evaluation.trained import evaluated
from nerfreg.field import FieldConfig
from nerfreg.registry import Hooks
from nerfreg.rendering.config import SamplerConfig
from nerfreg.runs.load import load_trained
from nerfreg.scenes import Scene
from nerfreg.scenes.procedural import Procedural
from nerfreg.training.checkpoint import State, load_checkpoint, save_checkpoint
from nerfreg.training.config import OptimConfig, TrainConfig
from nerfreg.training.trainer import Trainer

FIELD = FieldConfig(levels=4, finest=32, log2_entries=10, hidden=16)
SAMPLER = SamplerConfig(coarse=8, fine=8, skip_resolution=16, inside=1.0)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Procedural(size=24, views=4, test_views=1).load()


def make(scene: Scene, *plugins: Regularizer, steps: int = 20, **optim: float) -> Trainer:
    names = {type(plugin).__name__.lower(): plugin for plugin in plugins}
    train = TrainConfig(steps=steps, rays=32, quiet=True)
    return Trainer(scene, Hooks(names), FIELD, SAMPLER, OptimConfig(**optim), train)


def weights(trainer: Trainer) -> dict[str, Tensor]:
    return {name: x.clone() for name, x in trainer.field.state_dict().items()}


@dataclass
class Watch(Regularizer):
    """Keeps what it has seen."""

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        return Needs(neighbors="extra", unseen_rays=0.25)

    @hookimpl
    def nerfreg_prepare(self, photographs):
        views, height, width = photographs.images.shape[:3]
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        place = torch.stack([x, y], dim=-1).expand(views, height, width, 2)
        return {"place": place, "view": torch.arange(views).view(-1, 1, 1).expand(place.shape[:3])}

    @hookimpl
    def nerfreg_loss(self, rendering, step):
        self.rendering, self.step = rendering, step
        return {}


def test_rays_know_their_view_and_pixel(scene: Scene) -> None:
    watch = Watch()
    make(scene, watch).step()
    rays = watch.rendering.rays
    supervised = len(rays.targets)
    assert supervised == 24 and len(rays.unseen) == 8
    # Training rays and their extra neighbours belong to a camera, unseen ones do not.
    assert rays.seen.sum() == 2 * supervised
    assert (rays.view[rays.unseen] == -1).all() and rays.pixel[rays.unseen].isnan().all()
    seen = rays.seen.nonzero().squeeze(1)
    views = torch.tensor(scene.train)[rays.view[seen]]
    origins, directions = scene.cameras.rays_through(views, rays.pixel[seen])
    assert torch.equal(origins, rays.origins[seen])
    assert torch.allclose(directions, rays.directions[seen], atol=1e-6)
    assert ((rays.unseen_views >= 0) & (rays.unseen_views < len(scene.train))).all()
    # What was prepared comes back for the pixel that it belongs to.
    assert rays.data.keys() == {"watch.place", "watch.view"}
    assert torch.equal(rays.data["watch.place"], rays.pixel[:supervised].floor().long())
    assert torch.equal(rays.data["watch.view"], rays.view[:supervised])
    photographs = scene.photographs()
    x, y = rays.data["watch.place"].unbind(-1)
    image = photographs.images[rays.data["watch.view"], y, x]
    background = rays.background[:supervised]
    mixed = torch.lerp(background, image[:, :3], image[:, 3:])
    assert torch.equal(mixed, rays.targets)
    assert watch.step.scene.labels == tuple(scene.labels[view] for view in scene.train)


def test_hooks_that_change_nothing_train_the_same_weights(scene: Scene) -> None:
    @dataclass
    class Idle(Regularizer):
        """Implements hooks that return what they got."""

        @hookimpl(wrapper=True)
        def nerfreg_density(self):
            return (yield)

        @hookimpl(wrapper=True)
        def nerfreg_rays(self):
            return (yield)

        @hookimpl(wrapper=True)
        def nerfreg_rendering(self):
            return (yield)

        @hookimpl
        def nerfreg_empty(self, positions):
            return torch.zeros(len(positions), dtype=torch.bool)

    plain, idle = make(scene), make(scene, Idle())
    for _ in range(3):
        plain.step()
        idle.step()
    # Scattering what is not empty sums the gradient of the first row in another order.
    for name, value in weights(plain).items():
        assert torch.allclose(weights(idle)[name], value, atol=1e-6), name


@dataclass
class Shift(Regularizer):
    """Learns one shift of all origins."""

    rate: float = 1.0
    averaged: bool = True
    decay: float = 0.0
    in_evaluation: ClassVar[tuple[str, ...]] = ("nerfreg_rays",)

    @hookimpl
    def nerfreg_module(self, scene_info):
        self.cameras = len(scene_info.cameras)
        self.module = nn.Module()
        self.module.shift = nn.Parameter(torch.tensor([0.1, 0.0, 0.0]))
        flat = Schedule("constant", first=self.rate)
        return TrainedModule(
            self.module,
            lr_scale=0.5,
            weight_decay=self.decay,
            schedule=flat,
            averaged=self.averaged,
        )

    @hookimpl(wrapper=True)
    def nerfreg_rays(self, rays, step):
        rays = yield
        self.training = step.training
        return replace(rays, origins=rays.origins + self.module.shift)


def test_a_module_is_trained_through_the_rays(scene: Scene) -> None:
    plugin = Shift()
    trainer = make(scene, plugin)
    assert plugin.cameras == len(scene.train)
    trainer.step()
    # Adam's first step has the length of the rate: that of the optimizer, times 0.5.
    moved = (plugin.module.shift.detach() - torch.tensor([0.1, 0.0, 0.0])).abs()
    assert torch.allclose(moved, torch.full((3,), 0.5 * trainer.optim.lr), rtol=1e-3)
    assert trainer.optimizer.param_groups[0]["lr"] != trainer.optimizer.param_groups[1]["lr"]
    assert any(name.startswith("plugins.shift") for name in trainer.field.state_dict())


def test_rays_that_moved_are_clipped_to_the_box_again(scene: Scene) -> None:
    trainer = make(scene, Shift())
    step = trainer._step()
    rays = trainer.batches.draw(Needs())
    cast = trainer.renderer.cast(rays, step)
    near, far = scene.info.clipped(rays.origins + torch.tensor([0.1, 0.0, 0.0]), rays.directions)
    assert torch.equal(cast.near, near) and torch.equal(cast.far, far)
    assert not torch.equal(cast.near, rays.near)


def test_weight_decay_is_decoupled(scene: Scene) -> None:
    plain, decayed = Shift(), Shift(decay=100.0)
    for plugin in (plain, decayed):
        make(scene, plugin).step()
    factor = 1 - 0.5 * OptimConfig().lr * 100
    expected = plain.module.shift + torch.tensor([0.1, 0.0, 0.0]) * (factor - 1)
    assert torch.allclose(decayed.module.shift, expected, atol=1e-6)


@pytest.mark.parametrize("averaged", [True, False])
def test_the_average_leaves_out_what_asks_for_it(scene: Scene, averaged: bool) -> None:
    plugin = Shift(averaged=averaged)
    trainer = make(scene, plugin, ema=0.9)
    for _ in range(4):
        trainer.step()
    latest = plugin.module.shift.clone()
    with evaluated(trainer) as trained:
        assert torch.equal(plugin.module.shift, latest) is not averaged
        trained.renderer().view(scene.cameras, scene.test[0])
        assert plugin.training is False
    assert torch.equal(plugin.module.shift, latest)


@dataclass
class HalfEmpty(Regularizer):
    """The half of the box with x < 0 is empty."""

    @hookimpl
    def nerfreg_start(self, step):
        grid = torch.ones(2, 2, 2, dtype=torch.bool)
        grid[0] = False
        scene = step.scene
        self.grid = OccupancyGrid.over(scene.center, scene.half_box, grid)

    @hookimpl
    def nerfreg_empty(self, positions):
        return ~self.grid.contains(positions)

    @hookimpl
    def nerfreg_loss(self, rendering):
        self.rendering = rendering
        return {}


def test_empty_space_is_not_evaluated_and_has_no_density(scene: Scene) -> None:
    plugin = HalfEmpty()
    trainer = make(scene, plugin)
    trainer.step()
    made = plugin.rendering
    positions = made.rays.origins[:, None] + made.rays.directions[:, None] * made.t[..., None]
    # Off the border, where rounding decides.
    left = positions[..., 0] < scene.info.center[0] - 1e-4
    right = positions[..., 0] > scene.info.center[0] + 1e-4
    assert left.any() and right.any()
    assert (made.density[left] == 0).all() and (made.density[right] > 0).all()
    assert right.sum() <= trainer.renderer.points < made.t.numel()
    view = trainer._step().field
    points = positions[left][:5]
    assert (view.density(points) == 0).all() and (view.density_gradient(points) == 0).all()


def test_empty_space_is_not_rendered_in_views(scene: Scene) -> None:
    trainer = make(scene, HalfEmpty())
    for _ in range(3):
        trainer.step()
    with evaluated(trainer) as trained:
        renderer = trained.renderer()
        assert not renderer.occupancy.occupied[: renderer.sampler.skip_resolution // 2 - 2].any()
        with_hole = renderer.view(scene.cameras, scene.test[0])
        whole = replace(trained, hooks=Hooks()).renderer().view(scene.cameras, scene.test[0])
    assert with_hole.opacity.sum() < 0.9 * whole.opacity.sum()


@dataclass
class AllEmpty(Regularizer):
    """There is nothing anywhere."""

    @hookimpl
    def nerfreg_empty(self, positions):
        return torch.ones(len(positions), dtype=torch.bool)


def test_a_scene_that_is_all_empty_is_its_background(scene: Scene) -> None:
    trainer = make(scene, AllEmpty())
    [term] = trainer.step()
    assert term.value.isfinite() and trainer.renderer.points == 0


@dataclass
class Drop(Regularizer):
    """Drops every density but the first, in training."""

    @hookimpl(wrapper=True)
    def nerfreg_density(self, samples, step):
        density = yield
        self.samples = samples
        return torch.where(torch.arange(density.shape[1]) > 0, 0.0, density)

    @hookimpl
    def nerfreg_loss(self, rendering):
        self.rendering = rendering
        return {}


def test_density_is_changed_before_compositing_and_in_training_alone(scene: Scene) -> None:
    plugin = Drop()
    trainer = make(scene, plugin)
    trainer.step()
    assert (plugin.rendering.weights[:, 1:] == 0).all()
    samples = plugin.samples
    assert torch.allclose(trainer._step().field.activate(samples.raw), samples.density)
    assert torch.allclose(samples.deltas.sum(1), samples.rays.far - samples.rays.near, atol=1e-5)
    del plugin.samples
    with evaluated(trainer) as trained:
        trained.renderer().view(scene.cameras, scene.test[0])
    assert not hasattr(plugin, "samples")


@dataclass
class Tint(Regularizer):
    """An input of the colour network that tells the view, and a factor of what comes out."""

    in_evaluation: ClassVar[tuple[str, ...]] = ("nerfreg_rendering",)

    @property
    def color_inputs(self) -> int:
        return 2

    @hookimpl
    def nerfreg_color_input(self, samples, step):
        self.views = samples.view
        return torch.stack([samples.view, samples.t], dim=1).float()

    @hookimpl(wrapper=True)
    def nerfreg_rendering(self, step):
        rendering = yield
        self.last = step.training
        return replace(rendering, rgb=rendering.rgb * 0.5)


def test_color_inputs_and_renderings(scene: Scene) -> None:
    plugin = Tint()
    trainer = make(scene, plugin)
    first = trainer.field.color_network.layers[0]
    assert first.weight.shape[1] == 16 + FIELD.geometry + 2
    trainer.step()
    assert (plugin.views >= 0).all() and plugin.last
    with evaluated(trainer) as trained:
        view = trained.renderer().view(scene.cameras, scene.test[0])
        assert not plugin.last and (plugin.views == -1).all()
        assert view.rgb.max() <= 0.5
        trained.renderer().view(scene.cameras, scene.train[2])
        assert (plugin.views == 2).all()


@dataclass
class Wrong(Tint):
    """Returns fewer inputs than it declares."""

    @property
    def color_inputs(self) -> int:
        return 3


def test_color_inputs_of_another_width_are_refused(scene: Scene) -> None:
    with pytest.raises(PluginError, match=r"nerfreg_color_input.*returned shape \(\d+, 2\), not"):
        make(scene, Wrong()).step()


class Waves(nn.Module):
    """Sines of the position."""

    width = 12

    def forward(self, x: Tensor) -> Tensor:
        angles = torch.cat([x * 2**k * torch.pi for k in range(2)], dim=1)
        return torch.cat([angles.sin(), angles.cos()], dim=1)


@dataclass
class Encoders(Regularizer):
    """Sines in place of the grid and of the harmonics."""

    @hookimpl
    def nerfreg_encoder(self, which, scene_info):
        return Waves()


def test_encoders_replace_the_grid(scene: Scene) -> None:
    trainer = make(scene, Encoders())
    assert trainer.field.grid is None and not list(trainer._step().field.tables)
    first = trainer.field.density_network.layers[0].weight
    before = first.clone()
    trainer.step()
    assert first.shape == (16, 12) and not torch.equal(before, first)
    view = trainer._step().field
    points = torch.rand(6, 3, dtype=torch.float32) - 0.5
    assert view.encode(points).shape == (6, 12)
    slopes = view.density_gradient(points)
    assert slopes.requires_grad
    with evaluated(trainer) as trained:
        trained.renderer().view(scene.cameras, scene.test[0])


def test_an_encoder_without_a_width_is_refused(scene: Scene) -> None:
    @dataclass
    class Nameless(Regularizer):
        @hookimpl
        def nerfreg_encoder(self, which):
            return nn.Identity()

    with pytest.raises(PluginError, match="the encoder of positions has no attribute 'width'"):
        make(scene, Nameless())


@dataclass
class Poses(Regularizer):
    """Unseen cameras at the place of the first training camera."""

    tuple_of: bool = True

    @hookimpl
    def nerfreg_needs(self):
        return Needs(patch_size=2, unseen_rays=0.5, unseen_patches=0.25)

    @hookimpl
    def nerfreg_unseen_poses(self, scene_info, count, generator):
        poses = scene_info.cameras.poses[:1].expand(count, 3, 4)
        return (poses, torch.zeros(count, dtype=torch.long)) if self.tuple_of else poses

    @hookimpl
    def nerfreg_loss(self, rendering):
        self.rays = rendering.rays
        return {}


@pytest.mark.parametrize("tuple_of", [True, False])
def test_unseen_poses_are_chosen(scene: Scene, tuple_of: bool) -> None:
    plugin = Poses(tuple_of=tuple_of)
    make(scene, plugin).step()
    rays = plugin.rays
    assert len(rays.unseen) == 16
    assert torch.equal(rays.origins[rays.unseen], rays.origins.new_zeros(16, 3) +
                       scene.cameras.poses[scene.train[0], :, 3])  # fmt: skip
    # Without numbers, the intrinsics are those of training views at random.
    assert (len(rays.unseen_views.unique()) == 1) is tuple_of


def test_several_plugins_share_the_unseen_poses(scene: Scene) -> None:
    @dataclass
    class Others(Poses):
        @hookimpl
        def nerfreg_unseen_poses(self, scene_info, count, generator):
            poses = scene_info.cameras.poses[1:2].expand(count, 3, 4)
            return poses, torch.ones(count, dtype=torch.long)

    first, second = Poses(), Others()
    make(scene, first, second).step()
    _, counts = second.rays.unseen_views.unique(return_counts=True)
    # One patch of 2 x 2 for each, and 4 of the 8 single rays each.
    assert counts.tolist() == [8, 8]


@dataclass
class Learned(Regularizer):
    """Learns a number that no parameter holds."""

    remember: bool = True
    total: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        self.log: list[str] = []
        self.gain, self.history = 1.0, torch.zeros(3)

    @hookimpl
    def nerfreg_start(self, step):
        self.log.append(f"start {step.index}")

    @hookimpl
    def nerfreg_step_end(self, step):
        self.log.append(f"step {step.index}")
        self.gain *= 0.5
        self.history = self.history + 1

    @hookimpl
    def nerfreg_end(self, step):
        self.log.append(f"end {step.index}")

    @hookimpl(wrapper=True)
    def nerfreg_rendering(self):
        rendering = yield
        return replace(rendering, rgb=rendering.rgb * self.gain)

    in_evaluation: ClassVar[tuple[str, ...]] = ("nerfreg_rendering",)

    def state_dict(self) -> dict[str, Any]:
        if not self.remember:
            return {}
        return {"gain": self.gain, "deep": {"history": [self.history, float("inf")]}}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.gain, (self.history, self.bound) = state["gain"], state["deep"]["history"]


def test_state_of_plugins_is_saved_and_restored(scene: Scene, tmp_path, compose) -> None:
    plugin = Learned()
    trainer = make(scene, plugin)
    for _ in range(2):
        trainer.step()
    trainer.end()
    assert plugin.log == ["start 0", "step 0", "step 1", "end 2"]
    state = State(2, 1.0, 10, 0, 0.1, trainer.hooks.state_dict())
    with evaluated(trainer) as live:
        save_checkpoint(tmp_path, trainer.field, state)
        config = replace(compose(), field=FIELD, sampler=SAMPLER)
        fresh = trainer.hooks.fresh()
        loaded, saved = load_trained(tmp_path, config, scene, fresh, torch.device("cpu"))
        require_no_leak(live, saved)
    assert loaded.fraction == 0.1 and saved.step.training is False
    restored = fresh.plugins["learned"]
    assert restored is not plugin and restored.gain == 0.25
    assert torch.equal(restored.history, torch.full((3,), 2.0)) and restored.bound == float("inf")


def test_state_that_no_checkpoint_holds_is_a_leak(scene: Scene, tmp_path, compose) -> None:
    trainer = make(scene, Learned(remember=False), Tint())
    for _ in range(2):
        trainer.step()
    with evaluated(trainer) as live:
        save_checkpoint(tmp_path, trainer.field, State(2, 1.0, 10))
        config = replace(compose(), field=FIELD, sampler=SAMPLER)
        fresh = trainer.hooks.fresh()
        _, saved = load_trained(tmp_path, config, scene, fresh, torch.device("cpu"))
        with pytest.raises(PluginError, match="plugin learned: evaluation right after training"):
            require_no_leak(live, saved)


class Masked(nn.Module):
    """A layer whose output is masked until it is told otherwise."""

    def __init__(self, inner: nn.Module) -> None:
        super().__init__()
        self.inner, self.mask = inner, None

    def forward(self, x: Tensor) -> Tensor:
        y = self.inner(x)
        return y if self.mask is None else y * self.mask[: len(y)]


@dataclass
class LastMask(Regularizer):
    """Masks the density network in each step, and forgets to stop."""

    @hookimpl(wrapper=True)
    def nerfreg_layer(self, network, activation):
        layer = yield
        if network != "density" or activation != "none":
            return layer
        self.layer = Masked(layer)
        return self.layer

    @hookimpl
    def nerfreg_loss(self):
        self.layer.mask = torch.zeros(1)
        return {}


def test_a_mask_that_stays_in_force_is_a_leak(scene: Scene, tmp_path, compose) -> None:
    trainer = make(scene, LastMask(), Tint())
    trainer.step()
    with evaluated(trainer) as live:
        save_checkpoint(tmp_path, trainer.field, State(1, 1.0, 10))
        config = replace(compose(), field=FIELD, sampler=SAMPLER)
        fresh = trainer.hooks.fresh()
        _, saved = load_trained(tmp_path, config, scene, fresh, torch.device("cpu"))
        expected = r"plugin lastmask: .*\(layer 1 of the density network\)"
        with pytest.raises(PluginError, match=expected):
            require_no_leak(live, saved)


def test_dropout_of_torch_is_scored_in_evaluation(scene: Scene) -> None:
    @dataclass
    class Dropped(Regularizer):
        @hookimpl(wrapper=True)
        def nerfreg_layer(self):
            layer = yield
            return nn.Sequential(layer, nn.Dropout(0.5))

    trainer = make(scene, Dropped())
    trainer.step()
    with evaluated(trainer) as trained:
        renderer = trained.renderer()
        views = [renderer.view(scene.cameras, scene.test[0]).rgb for _ in range(2)]
    assert torch.equal(*views) and trainer.field.training


@dataclass
class Breaks(Regularizer):
    """Fails in a hook, or in a layer."""

    where: str = "loss"

    @hookimpl
    def nerfreg_loss(self, rendering):
        if self.where == "loss":
            raise KeyError("missing")
        return None if self.where == "none" else {"term": 1.0} if self.where == "float" else {}

    @hookimpl(wrapper=True)
    def nerfreg_layer(self, network, index):
        layer = yield
        chosen = self.where == "layer" and (network, index) == ("color", 0)
        return Failing(layer) if chosen else layer

    @hookimpl(wrapper=True)
    def nerfreg_ray_bounds(self):
        bounds = yield
        return None if self.where == "bounds" else bounds


class Failing(nn.Module):
    def __init__(self, inner: nn.Module) -> None:
        super().__init__()
        self.inner, self.calls = inner, 0

    def forward(self, x: Tensor) -> Tensor:
        self.calls += 1
        if self.calls == 3:
            raise ValueError("too often")
        return self.inner(x)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("loss", r"plugin breaks \(.*\), nerfreg_loss at step 0: KeyError: 'missing'"),
        ("none", r"nerfreg_loss at step 0: returned None; return a dictionary of terms, \{\}"),
        ("float", r"nerfreg_loss at step 0: term 'term' is of type float, return scalars"),
        ("layer", r"plugin breaks \(.*\), Failing.forward at step 2: ValueError: too often"),
        ("bounds", r"nerfreg_ray_bounds at step 0: returned None"),
    ],
)
def test_what_a_plugin_raises_names_plugin_hook_and_step(
    scene: Scene, where: str, message: str
) -> None:
    trainer = make(scene, Watch(), Breaks(where=where))
    with pytest.raises(PluginError, match=message) as caught:
        for _ in range(4):
            trainer.step()
    assert caught.value.exit_code == 4


@dataclass
class Pupil(Regularizer):
    """Compares the rendering with that of the averaged weights."""

    @hookimpl
    def nerfreg_loss(self, rendering, step):
        before = {id(p): p.data_ptr() for p in self.field.parameters()} if self.field else {}
        self.taught = step.teacher.rerender(rendering)
        self.density = step.teacher.density(rendering.rays.origins)
        if before:
            assert before == {id(p): p.data_ptr() for p in self.field.parameters()}
        return {"pupil": (rendering.rgb - self.taught.rgb).square().mean()}

    field: ClassVar[Any] = None


def test_the_teacher_is_the_moving_average(scene: Scene) -> None:
    plugin = Pupil()
    trainer = make(scene, plugin, ema=0.9)
    Pupil.field = trainer.field
    try:
        for _ in range(3):
            trainer.step()
        assert not plugin.taught.rgb.requires_grad
        # The same as rendering with the averaged weights in the field.
        step, rays = trainer._step(), trainer.batches.draw(Needs())
        made = trainer.renderer.render(rays, step)
        taught = step.teacher.rerender(made)
        with trainer.average.applied(), torch.no_grad():
            expected = trainer.renderer.render(rays, step, like=made)
        assert torch.equal(taught.rgb, expected.rgb)
        assert not torch.equal(taught.rgb, made.rgb)
        # Rendering by the teacher in between must not spoil the student's graph.
        made.rgb.sum().backward()
    finally:
        Pupil.field = None


def test_rerendering_with_a_shift_other_rays_and_densities_alone(scene: Scene) -> None:
    trainer = make(scene)
    step, rays = trainer._step(), trainer.batches.draw(Needs())
    made = trainer.renderer.render(rays, step)
    same = step.rerender(made)
    assert torch.allclose(same.rgb, made.rgb, atol=1e-6)
    shift = torch.tensor([0.05, 0.0, 0.0])
    moved = step.rerender(made, shift=shift)
    other = step.rerender(made, rays=replace(rays, origins=rays.origins + shift))
    assert torch.allclose(moved.density, other.density, rtol=1e-4, atol=1e-5)
    assert not torch.allclose(moved.density, made.density)
    alone = step.rerender(made, density_only=True)
    assert torch.equal(alone.density, same.density) and alone.rgb.isnan().all()
    frozen = step.rerender(made, frozen=True)
    assert not frozen.rgb.requires_grad
    with pytest.warns(DeprecationWarning, match="frozen=True"):
        assert torch.equal(step.probe(made).rgb, frozen.rgb)
    some = torch.tensor([3, 1])
    part = step.rerender(made.picked(some))
    assert torch.allclose(part.rgb, made.rgb[some], atol=1e-6)
    assert step.render(rays.picked(some)).rgb.shape == (2, 3)


def test_the_field_is_what_renderings_are_made_of(scene: Scene) -> None:
    trainer = make(scene)
    trainer.step()
    step, rays = trainer._step(), trainer.batches.draw(Needs())
    made = trainer.renderer.render(rays, step)
    along = rays.directions[:, None] * made.t[..., None]
    positions = (rays.origins[:, None] + along).flatten(0, 1)
    field = step.field
    assert torch.allclose(field.density(positions), made.density.flatten(), rtol=1e-4, atol=1e-5)
    directions = rays.directions.repeat_interleave(made.t.shape[1], 0)
    colors = field.color(positions, directions).view(*made.t.shape, 3)
    behind = torch.exp(-made.tau.sum(1, keepdim=True)) * rays.background
    # Colours of samples that can hardly be seen are left out.
    assert torch.allclose((made.weights[..., None] * colors).sum(1) + behind, made.rgb, atol=2e-3)


def test_density_gradient_is_that_of_the_density(scene: Scene) -> None:
    trainer = make(scene)
    for _ in range(3):
        trainer.step()
    field = trainer._step().field
    points = (torch.rand(40, 3, generator=torch.Generator().manual_seed(0)) - 0.5).requires_grad_()
    (expected,) = torch.autograd.grad(field.density(points).sum(), points)
    slopes = field.density_gradient(points.detach())
    assert torch.allclose(slopes, expected, rtol=1e-3, atol=1e-4)
    table = trainer.field.grid.table
    (second,) = torch.autograd.grad(slopes.square().mean(), table)
    # In float64, where the plain grid takes over, and against a finite difference there.
    trainer.field.double()
    table, exact = trainer.field.grid.table, points.detach().double()
    (plain,) = torch.autograd.grad(field.density_gradient(exact).square().mean(), table)
    assert (second - plain).norm() < 1e-3 * plain.norm()
    along = torch.randn(table.shape, generator=torch.Generator().manual_seed(1)).double()
    ends = []
    for stride in (1e-7, -2e-7):
        table.data += stride * along
        ends.append(float(field.density_gradient(exact, create_graph=False).square().mean()))
    assert float((plain * along).sum()) == pytest.approx((ends[0] - ends[1]) / 2e-7, rel=1e-3)


def test_schedules_are_followed(scene: Scene) -> None:
    @dataclass
    class Constant(Regularizer):
        @hookimpl
        def nerfreg_loss(self, rendering):
            return {"one": rendering.rgb.sum() * 0 + 1}

    plugin = Constant()
    plugin.schedules = {"weight": Schedule("linear", 1.0, 0.0, end=0.5)}
    trainer = make(scene, plugin, steps=8)
    steps = [[term.weight for term in trainer.step() if term.name == "one"] for _ in range(6)]
    # After half of the budget the weight is 0, and the plugin is left out.
    assert steps == [[1.0], [0.75], [0.5], [0.25], [], []]


def test_metrics_of_plugins(scene: Scene) -> None:
    @dataclass
    class Mean(Regularizer):
        @hookimpl
        def nerfreg_metrics(self, view, step):
            assert view.rgb.shape == view.target.shape and not step.training
            assert view.label == scene.labels[scene.test[0]]
            return {"brightness": float(view.rgb.mean()), "unknown": float("nan")}

    trainer = make(scene, Mean())
    with evaluated(trainer) as trained:
        renderer = trained.renderer()
        render = partial(renderer.view, scene.cameras)
        scores = score_views(scene, scene.test, render, None, measure=trained.measure)
        expected = float(render(scene.test[0]).rgb.clamp(0, 1).mean())
    assert scores.record()["metrics"] == {
        "mean.brightness": pytest.approx(expected),
        "mean.unknown": None,
    }


def test_a_checkpoint_without_fraction_can_still_be_read(tmp_path, scene: Scene) -> None:
    trainer = make(scene)
    save_checkpoint(tmp_path, trainer.field, State(1, 1.0, 10))
    path = tmp_path / "checkpoint" / "state.json"
    path.write_text('{"step": 1, "train_seconds": 1.0, "points": 10, "skipped_steps": 0}')
    assert load_checkpoint(tmp_path, trainer.field) == State(1, 1.0, 10)


@dataclass
class Patches(Regularizer):
    """Keeps the patches that it gets."""

    side: int = 2
    share: float = 0.5

    @hookimpl
    def nerfreg_needs(self):
        return Needs(patch_size=self.side, patch_fraction=self.share)

    @hookimpl
    def nerfreg_loss(self, rendering):
        self.rays = rendering.rays
        return {}


def test_each_plugin_gets_patches_of_its_own_side(scene: Scene) -> None:
    small, large = Patches(side=2), Patches(side=5, share=0.8)
    train = TrainConfig(steps=2, rays=32, quiet=True)
    hooks = Hooks({"a": small, "b": large})
    Trainer(scene, hooks, FIELD, SAMPLER, OptimConfig(), train).step()
    assert large.rays.patches.shape == (1, 5, 5)
    [patch] = large.rays.patches
    # Of 5 x 5 rays, 4 x 4 make four patches; the last row and column are left over.
    expected = [patch[y : y + 2, x : x + 2] for y in (0, 2) for x in (0, 2)]
    assert torch.equal(small.rays.patches, torch.stack(expected))
    pixels = small.rays.pixel[small.rays.patches]
    assert torch.equal(pixels[:, 0, 1] - pixels[:, 0, 0], torch.tensor([[1.0, 0.0]] * 4))
    assert torch.equal(pixels[:, 1, 0] - pixels[:, 0, 0], torch.tensor([[0.0, 1.0]] * 4))


def test_empty_space_is_where_samples_lie_and_not_where_encoders_see_them(scene: Scene) -> None:
    @dataclass
    class Away(Regularizer):
        """The encoders see everything far away."""

        @hookimpl(wrapper=True)
        def nerfreg_encoder_input(self):
            samples = yield
            return replace(samples, positions=samples.positions + 100.0)

    plain, moved = (make(scene, *plugins) for plugins in ((HalfEmpty(),), (Away(), HalfEmpty())))
    for trainer in (plain, moved):
        trainer.renderer.render(trainer.batches.draw(Needs()), trainer._step())
    assert 0 < plain.renderer.points < 32 * 16
    # Coarse samples are the same; importance samples follow other densities.
    assert 0 < moved.renderer.points < 32 * 16
