"""Where configuration comes from and what becomes of it."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra.errors import ConfigCompositionException
from nerfreg_plugins.entropy import RayEntropy
from omegaconf import DictConfig, OmegaConf

from nerfreg import NerfregError
from nerfreg.config.compose import compose as compose_in_program
from nerfreg.config.folders import own_folder, user_folders
from nerfreg.config.naming import run_name, slug
from nerfreg.config.saved import read_run
from nerfreg.config.schema import register
from nerfreg.config.search_path import options
from nerfreg.field import FieldConfig
from nerfreg.scenes import Procedural, load_scene

GROUPS = ("field", "sampler", "optim", "eval", "reg")
SHIPPED = [
    f"{path.parent.name}={path.stem}"
    for group in GROUPS
    for path in sorted((own_folder() / group).glob("*.yaml"))
]


@pytest.mark.parametrize("choice", SHIPPED)
def test_every_shipped_choice_composes(compose, choice: str) -> None:
    compose(f"+{choice}" if choice.startswith("reg=") else choice)


@pytest.mark.parametrize(
    "path", sorted((own_folder() / "scene").glob("*.yaml")), ids=lambda path: path.stem
)
def test_every_shipped_scene_composes(compose, path: Path) -> None:
    # a scene whose kind nobody names is asked for it, and there are no files here
    assert compose(f"scene={path.stem}", "++scene.layout=object").scene.layout == "object"


@pytest.mark.parametrize(
    "path", sorted(own_folder().rglob("*.yaml")), ids=lambda path: f"{path.parent.name}/{path.stem}"
)
def test_every_shipped_file_says_what_it_is_for(path: Path) -> None:
    assert path.read_text(encoding="utf-8").startswith("# ")


@pytest.mark.parametrize(
    ("name", "scene", "rays", "steps", "levels"),
    [("paper_llff", "llff", 4096, 9000, 16), ("paper_synthetic", "blender", 7008, 10000, 32)],
)
def test_the_papers_settings(
    compose, name: str, scene: str, rays: int, steps: int, levels: int
) -> None:
    """64 + 128 samples and 2^19 entries to 2048, whatever the photographs could fill."""
    kind = {"llff": "forward", "blender": "object"}[scene]  # not found, for there are no files here
    config = compose(f"+experiment={name}", "+reg=combinerf", f"scene.layout={kind}")
    assert config.scene.format == scene and config.scene.views == {"llff": 3, "blender": 8}[scene]
    assert (config.train.rays, config.train.steps, config.train.seconds) == (rays, steps, None)
    assert (config.sampler.coarse, config.sampler.fine) == (64, 128)
    assert (config.field.levels, config.field.finest, config.field.log2_entries) == (
        levels,
        2048,
        19,
    )
    assert not config.field.fit
    assert (config.optim.lr, config.optim.decay, config.optim.ema) == (1e-2, 0.1, 0.95)
    again = compose(
        f"+experiment={name}", "train.steps=10", "scene.views=6", f"scene.layout={kind}"
    )
    assert again.train.steps == 10


def test_types_are_those_of_the_rooms(compose) -> None:
    config = compose("field.levels=8")
    assert isinstance(config.scene, Procedural)
    assert isinstance(config.field, FieldConfig)
    assert (config.field.levels, config.seed, config.name, config.reg) == (8, 0, None, {})


@pytest.mark.parametrize("selection", ["distortion", "combinerf"])
def test_plugin_defaults_follow_the_layout(compose, selection: str) -> None:
    # DESIGN: 2e-5 for LLFF, which faces forward; 2e-3 for NeRF-Synthetic, which is orbited
    assert compose(f"+reg={selection}", "scene.layout=forward").reg["distortion"].weight == 2e-5
    for layout in ("orbit", "object", "room"):
        config = compose(f"+reg={selection}", f"scene.layout={layout}")
        assert config.reg["distortion"].weight == 2e-3
    override = "reg.distortion.weight=0.5"
    assert (
        compose(f"+reg={selection}", "scene.layout=forward", override).reg["distortion"].weight
        == 0.5
    )


def test_presets_may_depend_on_the_layout(compose) -> None:
    forward = compose("+reg=combinerf_plus", "scene.layout=forward").reg
    assert (forward["distortion"].weight, forward["unseen_smoothness"].weight) == (1e-3, 3e-3)
    orbit = compose("+reg=combinerf_plus", "scene.layout=orbit").reg
    assert (orbit["distortion"].weight, orbit["unseen_smoothness"].weight) == (2e-2, 0.0)
    assert forward["view_dependence"] == orbit["view_dependence"]
    assert compose("+reg=combinerf_plus", "scene.layout=null").reg == orbit, (
        "the cameras of this scene are on an orbit"
    )
    room = compose("+reg=combinerf_plus", "scene.layout=room").reg
    assert (room["occlusion"].weight, room["silhouettes"].weight) == (0.01, 0.0)
    assert (orbit["occlusion"].weight, orbit["silhouettes"].weight) == (0.0, 1.0)
    assert (
        compose("+reg=combinerf_plus", "scene.layout=orbit", "reg.occlusion.weight=1")
        .reg["occlusion"]
        .weight
        == 1.0
    )


def test_the_sampler_follows_the_layout(compose) -> None:
    assert compose("scene.layout=forward").sampler.spacing == "disparity"
    assert (
        compose("scene.layout=orbit").sampler.spacing
        == compose("scene.layout=null").sampler.spacing
        == "linear"
    )
    assert compose("scene.layout=forward", "sampler=importance").sampler.spacing == "linear", (
        "the paper's"
    )


def test_layout_that_nobody_names_is_asked_of_the_cameras(compose) -> None:
    # without scene.layout the procedural scene is an orbit
    assert compose("+reg=distortion", "scene.layout=null").reg["distortion"].weight == 2e-3


@pytest.fixture
def by_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Presets `two` and `three`, whose weights depend on the kind of capture."""
    folder = tmp_path / "conf" / "reg"
    folder.mkdir(parents=True)
    for name, values in (("two", "1,2"), ("three", "1,2,3"), ("one", "1"), ("four", "1,2,3,4")):
        text = f"defaults: [entropy, _self_]\nentropy:\n  weight: ${{by_layout:{values}}}\n"
        (folder / f"{name}.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("by_kind")
@pytest.mark.parametrize(
    ("layout", "two", "three"),
    [("forward", 1.0, 1.0), ("object", 2.0, 2.0), ("room", 2.0, 3.0)],
)
def test_two_values_or_three(compose, layout: str, two: float, three: float) -> None:
    assert compose("+reg=two", f"scene.layout={layout}").reg["entropy"].weight == two
    assert compose("+reg=three", f"scene.layout={layout}").reg["entropy"].weight == three


@pytest.mark.usefixtures("by_kind")
@pytest.mark.parametrize("name", ["one", "four"])
def test_another_number_of_values_is_refused(name: str) -> None:
    count = {"one": 1, "four": 4}[name]
    with pytest.raises(NerfregError) as error:
        compose_in_program([f"+reg={name}"])
    assert str(error.value) == (
        "reg.entropy.weight: by_layout takes the values FORWARD,ORBIT or FORWARD,OBJECT,ROOM, "
        f"not {count} of them"
    )


@pytest.mark.usefixtures("by_kind")
@pytest.mark.parametrize("layout", ["null", "orbit"])
@pytest.mark.parametrize(
    ("channels", "alpha", "kind", "weight"),
    [(4, None, "object", 2.0), (3, None, "room", 3.0), (4, 1.0, "room", 3.0)],
)
def test_objects_and_rooms_have_their_own_defaults(
    compose, capture, layout: str, channels: int, alpha: float | None, kind: str, weight: float
) -> None:
    path = capture(channels, alpha)
    config = compose(
        "+reg=three", "scene=transforms", f"scene.path={path}", f"scene.layout={layout}"
    )
    assert (config.scene.layout, config.reg["entropy"].weight) == (kind, weight)
    assert config.sampler.spacing == "linear" and config.scene.layout_found
    scene = load_scene(config.scene)
    assert (scene.layout, scene.layout_found) == (kind, True)


def test_a_plugin_may_tell_objects_from_rooms(compose, monkeypatch: pytest.MonkeyPatch) -> None:
    defaults = {"orbit": {"weight": 2.0, "start": 0.5}, "room": {"weight": 3.0}}
    monkeypatch.setattr(RayEntropy, "by_layout", defaults)
    for layout, weight in (("object", 2.0), ("room", 3.0), ("forward", RayEntropy().weight)):
        plugin = compose("+reg=entropy", f"scene.layout={layout}").reg["entropy"]
        start = RayEntropy().start if layout == "forward" else 0.5
        assert (plugin.weight, plugin.start) == (weight, start)


def test_a_scene_that_is_not_there_is_named(tmp_path: Path) -> None:
    missing = tmp_path / "nowhere"
    for scene, message in (
        ("scene=blender", "scene.path: not set"),
        (f"scene.path={missing}", f"scene.path={missing}: no such file or folder"),
        (f"scene.path={tmp_path}", "transforms_train.json: missing"),
    ):
        with pytest.raises(NerfregError, match=message):
            compose_in_program(["scene=blender", "+reg=distortion", scene])


def test_list_keeps_its_order(compose) -> None:
    assert list(compose("+reg=[kl,distortion]").reg) == ["kl", "distortion"]
    assert list(compose("+reg=[distortion,kl]").reg) == ["distortion", "kl"]


def test_start_is_a_step_or_a_fraction(compose) -> None:
    for text, value in (("1000", 1000), ("0.5", 0.5), ("1.0", 1.0)):
        start = compose("+reg=kl", f"reg.kl.start={text}", "reg.kl.end=2000").reg["kl"].start
        assert (type(start), start) == (type(value), value)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["+foo=1"], "unknown key 'foo'"),
        (["+train.stepz=1"], "unknown key 'train.stepz'; did you mean 'steps'"),
        (["+reg=kl", "+reg.kl.wieght=1"], "unknown key 'reg.kl.wieght'; did you mean 'weight'"),
        (["+reg.kl.weight=1"], r"reg.kl: not a selected plugin; select it by \+reg=kl"),
        (["+reg=kl", "reg.kl.weight=-1"], "reg.kl.weight=-1.0: must be finite and not negative"),
    ],
)
def test_bad_values_are_refused_before_anything_is_read(
    compose, overrides: list[str], message: str
) -> None:
    with pytest.raises(NerfregError, match=message):
        compose(*overrides)


def test_a_value_for_a_group_of_keys_is_refused() -> None:
    with pytest.raises(NerfregError, match="train=5: is a group of keys"):
        compose_in_program(["train=5"])


def test_typed_values(compose) -> None:
    with pytest.raises(ConfigCompositionException) as caught:
        compose("train.rays=many")
    assert "could not be converted to Integer" in str(caught.value.__cause__)


def test_folder_of_the_user_adds_choices(
    compose, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "conf" / "reg").mkdir(parents=True)
    (tmp_path / "conf" / "reg" / "mine.yaml").write_text(
        "defaults: [kl, _self_]\nkl: {weight: 0.25}\n"
    )
    (tmp_path / "xdg" / "nerfreg" / "scene").mkdir(parents=True)
    home = "defaults: [procedural_schema, _self_]\nviews: 3\n"
    (tmp_path / "xdg" / "nerfreg" / "scene" / "home.yaml").write_text(home)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "xdg"))
    assert user_folders() == [tmp_path / "conf", tmp_path / "xdg" / "nerfreg"]
    config = compose("+reg=mine", "scene=home")
    assert (config.reg["kl"].weight, config.scene.views) == (0.25, 3)
    assert {"mine", "kl", "combinerf"} <= {*options("reg", register())}


def test_own_folder_is_not_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.chdir(own_folder().parent)
    assert user_folders() == []


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("+reg=[lipschitz,kl],seed=0", "reg=lipschitz+kl,seed=0"),
        ("+reg=combinerf", "reg=combinerf"),
        ("scene=own/fern,scene.path=/a b/c", "scene=own-fern,scene.path=-a-b-c"),
        ("x" * 300, "x" * 100),
    ],
)
def test_slug(text: str, name: str) -> None:
    assert slug(text) == name


@pytest.mark.parametrize(
    ("overrides", "selected", "name", "expected"),
    [
        (["seed=1", "+reg=[kl,lipschitz]"], ["kl", "lipschitz"], None, "llff_kl+lipschitz"),
        (["+reg=combinerf"], ["kl", "distortion"], None, "llff_combinerf"),
        ([], ["kl", "distortion"], None, "llff_kl+distortion"),  # the user's own primary config
        ([], [], None, "llff_vanilla"),
        (["+reg=kl"], ["kl"], "My run", "My-run"),
    ],
)
def test_run_name(
    overrides: list[str], selected: list[str], name: str | None, expected: str
) -> None:
    hydra = {"runtime": {"choices": {"scene": "llff"}}, "overrides": {"task": overrides}}
    root = OmegaConf.create({"name": name, "reg": {key: {} for key in selected}, "hydra": hydra})
    assert isinstance(root, DictConfig)
    assert run_name(_root_=root) == expected


def saved_run(folder: Path, text: str) -> Path:
    (folder / ".hydra").mkdir()
    (folder / ".hydra" / "config.yaml").write_text(text, encoding="utf-8")
    return folder


RUN = """
scene: {format: procedural, layout: forward, views: 4}
reg: {distortion: {weight: '${distortion_by_layout:weight}'}}
"""


def test_saved_run_is_read_back_with_its_types(tmp_path: Path) -> None:
    config = read_run(saved_run(tmp_path, RUN), ["train.rays=7"])
    assert isinstance(config.scene, Procedural)
    assert (config.scene.views, config.reg["distortion"].weight, config.train.rays) == (4, 2e-5, 7)


@pytest.mark.parametrize(
    ("text", "overrides", "message"),
    [
        (RUN, ["train.rayz=7"], "unknown key 'train.rayz'; did you mean 'train.rays'"),
        (RUN, ["rays"], "'rays' is not an override; write key=value"),
        (RUN.replace("distortion", "gone"), [], "reg.gone is not installed here"),
        ("scene: {format: hologram}", [], "hologram"),
        ("a: [", [], "config.yaml"),
    ],
)
def test_saved_run_that_cannot_be_read(
    tmp_path: Path, text: str, overrides: list[str], message: str
) -> None:
    with pytest.raises(NerfregError, match=message):
        read_run(saved_run(tmp_path, text), overrides)


def test_runs_of_earlier_versions_name_no_kind(tmp_path: Path, capture) -> None:
    text = f"""
scene: {{format: transforms, layout: orbit, path: {capture(3)}}}
field: {{finest: '${{by_layout:2048,1024}}'}}
reg: {{distortion: {{weight: '${{distortion_by_layout:weight}}'}}}}
"""
    config = read_run(saved_run(tmp_path, text))
    assert (config.scene.layout, config.field.finest) == ("room", 1024)
    assert config.reg["distortion"].weight == 2e-3
    assert read_run(tmp_path, ["scene.layout=object"]).scene.layout == "object"


def test_no_run(tmp_path: Path) -> None:
    with pytest.raises(NerfregError, match="not the folder of a run"):
        read_run(tmp_path)
