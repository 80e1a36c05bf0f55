"""The same plugin under several names, and what keeps the names apart."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Literal

import pytest
from hydra.core.config_store import ConfigStore
from hydra.core.singleton import Singleton
from omegaconf import OmegaConf

from nerfreg import NerfregError, Regularizer
from nerfreg.config.compose import compose
from nerfreg.config.naming import overrides_name, slug
from nerfreg.config.plugin_store import known_plugins, split_choice, values_of
from nerfreg.config.saved import as_yaml, read_run, restored
from nerfreg.config.schema import register
from nerfreg.registry import plugins
from nerfreg.registry.plugins import plugin_name


@pytest.mark.parametrize(
    ("choice", "address", "name"),
    [
        ("kl", "kl", "kl"),
        ("kl@mine", "kl", "mine"),
        ("nerfreg-foo:kl", "nerfreg-foo:kl", "kl"),
        ("nerfreg-foo:kl@mine", "nerfreg-foo:kl", "mine"),
    ],
)
def test_what_a_choice_says(choice: str, address: str, name: str) -> None:
    assert split_choice(choice) == (address, name)


def test_a_plugin_twice_with_settings_of_its_own() -> None:
    words = ["+reg=[full_geometry,full_geometry@fg8]", "reg.fg8.patch_size=8"]
    reg = compose([*words, "reg.full_geometry.patch_size=4", "scene.layout=forward"]).reg
    assert {name: (plugin.patch_size, plugin.weight) for name, plugin in reg.items()} == {
        "full_geometry": (4, 1e-4),
        "fg8": (8, 1e-4),
    }
    assert {type(plugin) for plugin in reg.values()} == {type(reg["fg8"])}
    assert [plugin_name(name, plugin) for name, plugin in reg.items()] == ["full_geometry"] * 2
    assert list(compose(["+reg=kl@only"]).reg) == ["only"]


def test_a_preset_may_name_an_instance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "conf" / "reg").mkdir(parents=True)
    preset = "defaults: [kl, kl@far, _self_]\nfar: {weight: 0.25, neighbors: extra}\n"
    (tmp_path / "conf" / "reg" / "twice.yaml").write_text(preset)
    (tmp_path / "conf" / "reg" / "wrong.yaml").write_text("defaults: [kl@distortion, _self_]\n")
    monkeypatch.chdir(tmp_path)
    config = compose(["+reg=twice", "reg.far.start=0.5"])
    far = config.reg["far"]
    assert (config.reg["kl"].weight, far.weight, far.neighbors, far.start) == (
        1e-5, 0.25, "extra", 0.5,
    )  # fmt: skip
    assert plugin_name("far", far) == "kl"
    assert restored(OmegaConf.create(as_yaml(config)), "here").reg == config.reg
    with pytest.raises(NerfregError, match="'distortion' after @ is the name of a plugin"):
        compose(["+reg=wrong"])


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["+reg=kl@8"], "reg=kl@8: '8' after @ is no name; use letters, digits and _"),
        (["+reg=kl@distortion"], "'distortion' after @ is the name of a plugin or preset"),
        (["+reg=kl@combinerf"], "'combinerf' after @ is the name of a plugin or preset"),
        (["+reg=combinerf@mine"], "'combinerf' is a preset; only a plugin can have another name"),
        (["+reg=kll@mine"], "unknown plugin or preset 'kll@mine' in reg=kll@mine; did you mean"),
        (["+reg=nerfreg:kll"], "package nerfreg has no plugin 'kll'; did you mean 'kl'?"),
        (["+reg=[kl@a,distortion@a]"], "two plugins would be called 'a'"),
        (["+reg=[kl,nerfreg:kl]"], "two plugins would be called 'kl'"),
        (["+reg=kl@a", "reg.a.plugin=entropy"], "reg.a.plugin=entropy: cannot be changed"),
        (["+reg=kl@a", "reg.kl.weight=1"], "reg.kl is not selected; add +reg=kl"),
        (
            ["+reg=kl@a", "reg.a.weihgt=1"],
            "unknown key 'reg.a.weihgt'; did you mean 'reg.a.weight'?",
        ),
        (["+reg=annealing@a", "reg.a.mid=5"], "reg.a.mid: 5.0 is not in [0, 1]"),
    ],
)
def test_names_that_cannot_be_used(overrides: list[str], message: str) -> None:
    with pytest.raises(NerfregError) as caught:
        compose(overrides)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_two_lists_of_a_preset_that_clash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "conf" / "reg").mkdir(parents=True)
    (tmp_path / "conf" / "reg" / "one.yaml").write_text("defaults: [kl@a, _self_]\n")
    (tmp_path / "conf" / "reg" / "two.yaml").write_text("defaults: [distortion@a, _self_]\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(NerfregError, match="plugin distortion would have the name of another"):
        compose(["+reg=[one,two]"])


RUN = """
scene: {format: procedural, layout: forward, views: 4}
reg:
  kl: {weight: 0.5}
  far: {plugin: nerfreg:distortion, weight: '${distortion_by_layout:weight}'}
"""


def test_a_run_of_an_earlier_version_names_plugins_by_their_keys(tmp_path: Path) -> None:
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "config.yaml").write_text(RUN, encoding="utf-8")
    reg = read_run(tmp_path, ["reg.far.end=0.5"]).reg
    assert (type(reg["kl"]).__name__, reg["kl"].weight) == ("KLDivergence", 0.5)
    assert (type(reg["far"]).__name__, reg["far"].weight, reg["far"].end) == (
        "Distortion", 2e-5, 0.5,
    )  # fmt: skip
    gone = RUN.replace("nerfreg:distortion", "nerfreg-gone:it")
    (tmp_path / ".hydra" / "config.yaml").write_text(gone, encoding="utf-8")
    with pytest.raises(NerfregError, match=r"reg.far \(plugin nerfreg-gone:it\) is not installed"):
        read_run(tmp_path)


def test_another_process_knows_the_same_choices() -> None:
    """What a launcher sends to its processes still makes instances on demand."""
    register()
    state = Singleton.get_state()
    try:
        Singleton.set_state(state)
        assert {"kl", "distortion"} <= {plugin.name for plugin in known_plugins()}
        assert list(compose(["+reg=kl@mine"]).reg) == ["mine"]
        group = ConfigStore.instance().repo["reg"]
        assert "kl@mine.yaml" in group and "kl@8.yaml" not in group and "kll.yaml" not in group
    finally:
        register()


def test_names_of_folders() -> None:
    assert slug("+reg=[kl,kl@far]") == "reg=kl+kl@far"
    schedule = "reg.kl.weight={schedule:linear,from:0.001,to:0}"
    name = "reg=kl,reg.kl.weight=schedule-linear+from-0.001+to-0"
    assert overrides_name(["+reg=kl", schedule]) == name
    assert slug("a={schedule: linear, from: 1}") == "a=schedule-linear+from-1"


@dataclass
class Chooser(Regularizer):
    """Has fields with a few values each."""

    mode: Literal["mean", "sum"] = "mean"
    order: Literal[1, 2] = 1
    kinds: list[Literal["a", "b-c"]] = field(default_factory=lambda: ["a"])  # type: ignore[list-item]
    norm: Literal["l1", "l2"] | None = None


@pytest.fixture
def chooser(monkeypatch: pytest.MonkeyPatch) -> None:
    installed = plugins._entry_points()
    point = EntryPoint("chooser", f"{__name__}:Chooser", plugins.GROUP)
    monkeypatch.setattr(plugins, "_entry_points", lambda: [*installed, point])


@pytest.mark.usefixtures("chooser")
def test_literals_are_choices() -> None:
    defaults = compose(["+reg=chooser"]).reg["chooser"]
    assert (defaults.mode, type(defaults.mode)) == ("mean", str) and defaults.norm is None
    words = ["mode=sum", "order=2", "kinds=[b-c,a]", "norm=l1"]
    config = compose(["+reg=chooser", *(f"reg.chooser.{word}" for word in words)])
    made = config.reg["chooser"]
    assert (made.mode, made.order, made.kinds, made.norm) == ("sum", 2, ["b-c", "a"], "l1")
    assert restored(OmegaConf.create(as_yaml(config)), "here").reg == config.reg
    assert compose(["+reg=chooser", "reg.chooser.norm=null"]).reg["chooser"].norm is None


@pytest.mark.usefixtures("chooser")
def test_a_shell_is_told_the_choices() -> None:
    plugins = register()
    assert values_of("reg.chooser.mode", ["+reg=chooser"], plugins) == ["mean", "sum"]
    assert values_of("reg.mine.order", ["+reg=[kl,chooser@mine]"], plugins) == ["1", "2"]
    assert values_of("reg.kl.direction", [], plugins) == ["forward", "reverse"]
    assert values_of("reg.chooser.weight", [], plugins) == []
    assert values_of("train.rays", [], plugins) == values_of("reg.nobody.mode", [], plugins) == []


@pytest.mark.usefixtures("chooser")
@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("mode=man", "reg.chooser.mode: 'man' is no choice; did you mean 'mean'?"),
        ("mode=null", "field 'reg.chooser.mode' is not Optional"),
        ("mode=[sum]", "reg.chooser.mode: '['sum']' is no choice"),
        ("order=3", "reg.chooser.order: '3' is no choice; known: 1, 2"),
        ("order=true", "reg.chooser.order: 'True' is no choice"),
        ("kinds=[c]", "reg.chooser.kinds"),
    ],
)
def test_other_values_are_no_choice(override: str, message: str) -> None:
    with pytest.raises(NerfregError) as caught:
        compose(["+reg=chooser", f"reg.chooser.{override}"])
    assert message in str(caught.value) and "\n" not in str(caught.value)
