"""Which plugins are installed, by which names they are selected, and what instances carry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest

from nerfreg import Needs, Regularizer, Schedule, hookimpl
from nerfreg.registry import installed, plugins
from nerfreg.registry.plugin_fields import field_mistake
from nerfreg.registry.plugins import (
    ADDRESS,
    conflicts_of,
    find_plugin,
    is_used,
    plugin_name,
    why_not,
    with_changes,
)


@dataclass
class ByKind(Regularizer):
    """A plugin that tells all kinds of capture apart."""

    by_layout: ClassVar[dict[str, dict[str, float]]] = {
        kind: {"weight": 1.0} for kind in ("forward", "object", "room", "orbit")
    }


@dataclass
class Constant(Regularizer):
    """A loss term of 3, on patches of side 4.

    More of it.
    """

    conflicts: ClassVar[tuple[str, ...]] = ("loner", "other:loner")

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        return Needs(patch_size=4)

    @hookimpl
    def nerfreg_loss(self):
        return {}

    @hookimpl
    def nerfreg_reference(self):
        return None


def claim(monkeypatch: pytest.MonkeyPatch, claims: Mapping[str, str]) -> None:
    """Install `Constant` under a name in each package; None stands for nerfreg itself."""
    points = []
    for package, name in claims.items():
        point = EntryPoint(name, f"{__name__}:Constant", plugins.GROUP)
        if package != "nerfreg":
            vars(point)["dist"] = SimpleNamespace(name=package, version="1.2")
        points.append(point)
    monkeypatch.setattr(plugins, "_entry_points", lambda: points)


def test_hook_points_and_summary(monkeypatch: pytest.MonkeyPatch) -> None:
    claim(monkeypatch, {"nerfreg": "constant"})
    [plugin] = installed()
    assert plugin.hook_points == ("needs", "loss")
    assert plugin.summary == "A loss term of 3, on patches of side 4."
    assert replace(plugin, cls=None, error="gone").state == "gone"


def test_a_name_that_nobody_else_has(monkeypatch: pytest.MonkeyPatch) -> None:
    claim(monkeypatch, {"other": "constant"})
    [plugin] = found = installed()
    assert (plugin.address, plugin.state, plugin.rivals) == ("constant", "ok", ())
    assert find_plugin("constant", found) is find_plugin("other:constant", found) is plugin
    assert find_plugin("other", found) is None and find_plugin("another:constant", found) is None


def test_a_built_in_keeps_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    claim(monkeypatch, {"a_package": "kl", "nerfreg": "kl", "b": "kl"})
    a, b, own = found = installed()
    assert [plugin.address for plugin in found] == ["a_package:kl", "b:kl", "kl"]
    assert own.state == "ok" and find_plugin("kl", found) is own
    assert b.state == "the name 'kl' is that of a built-in; select this one by +reg=b:kl" == b.clash
    assert find_plugin("nerfreg:kl", found) is own and find_plugin("b:kl", found) is b
    # As in an index of packages.
    assert find_plugin("A-package:kl", found) is find_plugin("a_package:kl", found) is a


def test_of_two_strangers_neither_has_the_name(monkeypatch: pytest.MonkeyPatch) -> None:
    claim(monkeypatch, {"b": "twin", "a": "twin"})
    a, b = found = installed()
    assert find_plugin("twin", found) is None
    assert (find_plugin("a:twin", found), find_plugin("b:twin", found)) == (a, b)
    assert a.state == "the name 'twin' is also that of b; select it by +reg=a:twin"
    expected = "plugin 'twin' is claimed by both a and b; write +reg=a:twin or +reg=b:twin"
    assert why_not("twin", found) == expected


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("stranger:twins", "package stranger has no plugin 'twins'; did you mean 'twin'?"),
        ("strangers:twin", "no plugin comes from package 'strangers'; did you mean 'stranger'?"),
        ("twins", ""),
    ],
)
def test_why_there_is_no_plugin(
    address: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    claim(monkeypatch, {"stranger": "twin"})
    assert why_not(address, installed()) == message


def test_source_checkout_reads_its_own_pyproject(tmp_path: Path) -> None:
    pyproject = tmp_path / "pyproject.toml"
    assert plugins._checkout_entry_points(pyproject) == []
    pyproject.write_text(
        '[project]\nname = "other"\n[project.entry-points."nerfreg.plugins"]\nx = "y:Z"\n'
    )
    assert plugins._checkout_entry_points(pyproject) == []
    pyproject.write_text(
        '[project]\nname = "nerfreg"\n[project.entry-points."nerfreg.plugins"]\nx = "y:Z"\n'
    )
    assert plugins._checkout_entry_points(pyproject) == [EntryPoint("x", "y:Z", plugins.GROUP)]


def test_ours_are_all_installed() -> None:
    ours = {plugin.name: plugin for plugin in installed() if plugin.package == "nerfreg"}
    expected = (
        "adversarial annealing convex_prior depth_smoothness distortion encoding_mask entropy "
        "full_geometry kl lipschitz occlusion",
        "silhouettes stereo unseen_smoothness view_dependence",
    )
    assert sorted(ours) == " ".join(expected).split()
    assert {plugin.state for plugin in ours.values()} == {"ok"}
    assert all(plugin.summary and plugin.hook_points for plugin in ours.values())


def instance(address: str = "", schedule: Schedule | None = None, **values: float) -> Constant:
    plugin = Constant(**values)
    vars(plugin).update({ADDRESS: address} if address else {})
    vars(plugin).update({"schedules": {"weight": schedule}} if schedule else {})
    return plugin


def test_an_instance_knows_its_plugin() -> None:
    assert plugin_name("mine", instance("constant")) == "constant"
    assert plugin_name("constant", instance()) == "constant"


def test_conflicts_are_those_of_plugins_whatever_their_instances_are_called() -> None:
    others = {
        "mine": instance("loner"),
        "loner": instance("constant"),
        "theirs": instance("other:loner"),
        "last": instance("third:loner"),
    }
    assert conflicts_of(instance(), others) == ["mine", "theirs"]


def test_a_plugin_whose_weight_begins_at_zero_is_used() -> None:
    assert is_used(instance(weight=1e-3)) and not is_used(instance(weight=0.0))
    assert is_used(instance(weight=0.0, schedule=Schedule("linear", 0.0, 1.0)))


def test_a_changed_instance_keeps_name_and_schedule() -> None:
    schedule = Schedule("linear", 0.0, 1.0)
    changed = with_changes(instance("constant", schedule, weight=0.0), end=0.5)
    assert isinstance(changed, Constant) and (changed.weight, changed.end) == (0.0, 0.5)
    assert plugin_name("mine", changed) == "constant"
    assert changed.schedules == {"weight": schedule}
    assert vars(with_changes(instance(), end=0.5)).keys() == {"weight", "start", "end"}


def test_defaults_may_depend_on_any_kind_of_capture(monkeypatch: pytest.MonkeyPatch) -> None:
    assert field_mistake(ByKind) == ""
    monkeypatch.setattr(ByKind, "by_layout", {"rooms": {"weight": 1.0}})
    assert field_mistake(ByKind) == "ByKind.by_layout names 'rooms'; did you mean 'room'?"
