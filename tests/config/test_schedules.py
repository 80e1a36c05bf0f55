"""Numbers that change over a run, from the command line to the plugin and back."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, ClassVar

import pytest
from omegaconf import OmegaConf

from nerfreg import NerfregError, Regularizer, Schedule
from nerfreg.config.compose import compose
from nerfreg.config.plugin import make_plugin, plugin_config, settings_of
from nerfreg.config.saved import as_yaml, restored
from nerfreg.errors import require_range
from nerfreg.registry import PluginInfo, plugins

LINEAR = "{schedule: linear, from: 1e-3, to: 0}"


@dataclass
class Sharp(Regularizer):
    """Has a number that may change, within limits, and one that may not."""

    weight: float = 0.5
    sharpness: float = 1.0
    size: int = 4

    by_layout: ClassVar[dict[str, dict[str, Any]]] = {"forward": {"sharpness": 2.0}}
    schedulable: ClassVar[tuple[str, ...]] = ("sharpness",)

    def __post_init__(self) -> None:
        require_range("reg.sharp", self, sharpness=(0.5, 4.0))


@pytest.fixture(autouse=True)
def sharp(monkeypatch: pytest.MonkeyPatch) -> None:
    installed = plugins._entry_points()
    point = EntryPoint("sharp", f"{__name__}:Sharp", plugins.GROUP)
    monkeypatch.setattr(plugins, "_entry_points", lambda: [*installed, point])


@pytest.mark.parametrize(
    ("text", "schedule"),
    [
        ("{schedule: constant, from: 2}", Schedule("constant", 2.0)),
        (LINEAR, Schedule("linear", 1e-3, 0.0)),
        (
            "{schedule:cosine,from:1e-3,to:0,start:0.1}",
            Schedule("cosine", 1e-3, 0.0, 0.1),
        ),
        (
            "{schedule: exponential, from: 1, to: '1e-3', start: 0.25, end: 0.75}",
            Schedule("exponential", 1.0, 1e-3, 0.25, 0.75),
        ),
        (
            "{schedule: piecewise, points: [[0, 1], [0.5, 2e-1]]}",
            Schedule("piecewise", points=((0.0, 1.0), (0.5, 0.2))),
        ),
    ],
)
def test_every_kind_is_read_and_written(text: str, schedule: Schedule) -> None:
    plugin = compose(["+reg=kl", f"reg.kl.weight={text}"]).reg["kl"]
    assert plugin.schedules == {"weight": schedule}
    assert plugin.weight == schedule.at(0.0)
    assert Schedule.read(schedule.written()) == schedule
    assert settings_of(plugin)["weight"] == schedule.written()


def test_other_numbers_are_as_before() -> None:
    plugin = compose(["+reg=sharp", "reg.sharp.weight=2", "scene.layout=forward"]).reg["sharp"]
    assert (plugin.weight, type(plugin.weight)) == (2.0, float)
    assert (plugin.sharpness, plugin.schedules) == (2.0, {})


def test_a_field_that_the_plugin_names_follows_its_schedule(step) -> None:
    override = "reg.sharp.sharpness={schedule: linear, from: 1, to: 3, start: 0.5}"
    plugin = compose(["+reg=sharp", override]).reg["sharp"]
    values = []
    for index in (0, 50, 75, 100):
        plugin.follow_schedules(step(index))
        values.append(plugin.sharpness)
    assert values == [1.0, 1.0, 2.0, 3.0]
    assert settings_of(plugin)["sharpness"]["from"] == 1.0, "and not the number of this moment"


def test_a_later_value_replaces_the_whole_schedule(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "conf" / "reg").mkdir(parents=True)
    preset = "defaults: [sharp, _self_]\nsharp:\n  weight: {schedule: cosine, from: 1, to: 0}\n"
    (tmp_path / "conf" / "reg" / "fading.yaml").write_text(preset)
    monkeypatch.chdir(tmp_path)

    def weight(*overrides: str) -> dict[str, Schedule] | float:
        plugin = compose(["+reg=fading", *overrides]).reg["sharp"]
        return plugin.schedules or plugin.weight

    assert weight() == {"weight": Schedule("cosine", 1.0, 0.0)}
    assert weight("reg.sharp.weight=3") == 3.0
    points = "reg.sharp.weight={schedule: piecewise, points: [[0, 1]]}"
    assert weight(points) == {"weight": Schedule("piecewise", points=((0.0, 1.0),))}


def test_a_preset_may_refer_to_the_layout_in_a_schedule(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "conf" / "reg").mkdir(parents=True)
    schedule = "{schedule: linear, from: '${by_layout:1,2}', to: 0}"
    preset = f"defaults: [sharp, _self_]\nsharp:\n  weight: {schedule}\n"
    (tmp_path / "conf" / "reg" / "fading.yaml").write_text(preset)
    monkeypatch.chdir(tmp_path)
    for layout, first in (("forward", 1.0), ("orbit", 2.0)):
        plugin = compose(["+reg=fading", f"scene.layout={layout}"]).reg["sharp"]
        assert plugin.schedules == {"weight": Schedule("linear", first, 0.0)}
    unknown = "reg.sharp.weight={schedule: linear, from: '${name}', to: 0}"
    with pytest.raises(NerfregError, match=r"reg.sharp.weight: from=x: must be a number"):
        compose(["+reg=sharp", unknown, "name=x"])


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("weight=abc", f"'abc' is neither a number nor a schedule such as {LINEAR}"),
        ("weight=true", f"'True' is neither a number nor a schedule such as {LINEAR}"),
        ("weight=[1,2]", f"'[1, 2]' is neither a number nor a schedule such as {LINEAR}"),
        ("weight=null", "field 'reg.sharp.weight' is not Optional"),
        ("weight={from: 1, to: 0}", f"a schedule names its kind, as in {LINEAR}"),
        ("weight={schedule: 3}", f"a schedule names its kind, as in {LINEAR}"),
        ("weight={schedule: cosin, from: 1, to: 0}", "schedule=cosin: did you mean 'cosine'?"),
        ("weight={schedule: linear, to: 0}", "a linear schedule needs 'from'"),
        ("weight={schedule: piecewise}", "a piecewise schedule needs 'points'"),
        (
            "weight={schedule: linear, form: 1, to: 0}",
            "unknown key 'form' in a linear schedule; did you mean 'from'?",
        ),
        (
            "weight={schedule: constant, from: 1, to: 0}",
            "unknown key 'to' in a constant schedule; known: from, schedule",
        ),
        ("weight={schedule: linear, from: a, to: 0}", "from=a: must be a number"),
        ("weight={schedule: linear, from: 1, to: true}", "to=True: must be a number"),
        (
            "weight={schedule: linear, from: 1, to: nan}",
            "schedule linear: its values must be finite numbers",
        ),
        (
            "weight={schedule: linear, from: 1, to: 0, start: 0.5, end: 0.2}",
            "schedule linear: start=0.5 must be before end=0.2, both shares of the budget "
            "from 0 to 1",
        ),
        (
            "weight={schedule: piecewise, points: [[0, 1, 2]]}",
            "points=[[0, 1, 2]]: must be pairs [share, value], as in [[0, 1e-3], [0.5, 0]]",
        ),
        (
            "weight={schedule: piecewise, points: 3}",
            "points=3: must be pairs [share, value], as in [[0, 1e-3], [0.5, 0]]",
        ),
        (
            "weight={schedule: linear, from: 1, to: -1}",
            "a schedule that comes to -1; must not be negative",
        ),
        (
            "weight={schedule: piecewise, points: [[0, 1], [0.5, -2], [1, 0]]}",
            "a schedule that comes to -2; must not be negative",
        ),
        (
            "sharpness={schedule: linear, from: 1, to: 9}",
            "reg.sharp.sharpness=9.0: must be between 0.5 and 4",
        ),
        (
            "size={schedule: linear, from: 1, to: 9}",
            "reg.sharp.size: follows no schedule; of this plugin weight, sharpness can",
        ),
        (
            "start={schedule: linear, from: 0, to: 1}",
            "reg.sharp.start: follows no schedule; of this plugin weight, sharpness can",
        ),
    ],
)
def test_what_is_neither_is_refused(override: str, message: str) -> None:
    with pytest.raises(NerfregError) as caught:
        compose(["+reg=sharp", f"reg.sharp.{override}"])
    error = str(caught.value)
    key = override.partition("=")[0]
    assert message in error and f"reg.sharp.{key}" in error and "\n" not in error


def test_a_saved_configuration_has_the_schedule(step) -> None:
    words = ["+reg=[sharp,sharp@second]", f"reg.sharp.weight={LINEAR}", "reg.second.size=8"]
    config = compose([*words, "reg.second.sharpness={schedule: constant, from: 3}"])
    config.reg["sharp"].follow_schedules(step(50))
    again = restored(OmegaConf.create(as_yaml(config)), "here")
    assert again.reg["sharp"].schedules == {"weight": Schedule("linear", 1e-3, 0.0)}
    assert again.reg["second"] == config.reg["second"]
    assert again.reg["second"].schedules == {"sharpness": Schedule("constant", 3.0)}
    assert as_yaml(again) == as_yaml(config)
    changed = [f"reg.second.weight={LINEAR.replace(' ', '')}", "reg.sharp.weight=2"]
    later = restored(OmegaConf.create(as_yaml(config)), "here", changed)
    assert later.reg["second"].schedules["weight"] == Schedule("linear", 1e-3, 0.0)
    assert (later.reg["sharp"].weight, later.reg["sharp"].schedules) == (2.0, {})
    json.dumps({name: settings_of(plugin) for name, plugin in config.reg.items()})


def test_a_check_configures_a_plugin_by_itself() -> None:
    info = PluginInfo("sharp", "own", "1", Sharp)

    def made(*overrides: str) -> Regularizer:
        return make_plugin("sharp", plugin_config(info, overrides))

    assert made("reg.sharp.sharpness=2", "reg.sharp.weight=1e-2").weight == 1e-2
    assert made("reg.sharp.weight={schedule:linear,from:1,to:0}").schedules
    refusals: dict[str, str] = {
        "reg.sharp.sharpnes=2": "unknown key 'reg.sharp.sharpnes'; did you mean 'sharpness'?",
        "reg.sharp.plugin=kl": "unknown key 'reg.sharp.plugin'",
        "reg.sharp.weight=heavy": "reg.sharp: 'heavy' is neither a number nor a schedule",
        "reg.sharp.sharpness=9": "reg.sharp.sharpness=9.0: must be between 0.5 and 4",
        "reg.sharp.sharpness={schedule:linear,from:1,to:9}": "reg.sharp.sharpness=9.0",
    }
    for override, message in refusals.items():
        with pytest.raises(NerfregError) as caught:
            made(override)
        assert message in str(caught.value)


def test_values_between_the_corners_lie_between_them(step: Callable[..., Any]) -> None:
    for kind in ("linear", "exponential", "cosine"):
        schedule = Schedule(kind, 1e-3, 1.0, 0.2, 0.8)
        values = [schedule.at(index / 50) for index in range(51)]
        assert values == sorted(values) and (values[0], values[-1]) == (1e-3, 1.0)
    exponential, cosine = (Schedule(kind, 1e-4, 1.0) for kind in ("exponential", "cosine"))
    assert exponential.at(0.5) == pytest.approx(1e-2)
    assert cosine.at(0.5) == pytest.approx((1e-4 + 1) / 2)
    points = Schedule("piecewise", points=((0.2, 1.0), (0.4, 3.0), (1.0, 0.0)))
    assert [points.at(share) for share in (0.0, 0.3, 0.4, 0.7, 1.0)] == pytest.approx(
        [1.0, 2.0, 3.0, 1.5, 0.0]
    )
