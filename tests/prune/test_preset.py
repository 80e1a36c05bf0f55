from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from nerfreg_plugins.entropy import RayEntropy

from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.prune.preset import changed_settings, plain, preset_path, write_preset


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_preset_selects_the_set_with_the_users_settings(compose: Callable[..., Config]) -> None:
    words = ("reg.distortion.weight=3e-4", "reg.kl.start=100", "reg.lipschitz.networks=[color]")
    config = compose("+reg=combinerf_dagger", *words, "scene.layout=forward")
    path = preset_path("pruned_fern")
    write_preset(path, config, ("kl", "distortion", "lipschitz"), ["of it.", "second line"])
    assert path == Path("conf", "reg", "pruned_fern.yaml")
    assert path.read_text().startswith("# What `nerfreg prune` leaves of it.\n# second line\n")
    again = compose("+reg=pruned_fern", "scene.layout=forward")
    assert again.reg == {name: config.reg[name] for name in ("kl", "distortion", "lipschitz")}
    assert again.reg["kl"].start == 100 and isinstance(again.reg["kl"].start, int)
    assert (
        again.reg["kl"].density == config.reg["kl"].density != compose("+reg=kl").reg["kl"].density
    )
    # and on top of it the command line still has the last word
    assert compose("+reg=pruned_fern", "reg.kl.weight=0.5").reg["kl"].weight == 0.5


def test_what_nobody_changed_follows_the_layout(compose: Callable[..., Config]) -> None:
    config = compose("+reg=[distortion,kl]", "scene.layout=forward", "reg.kl.weight=0.25")
    assert changed_settings(config, "distortion") == {}
    assert changed_settings(config, "kl") == {"weight": 0.25}
    write_preset(preset_path("mine"), config, ("distortion",), ["of it."])
    orbit, forward = (
        compose("+reg=mine", f"scene.layout={layout}").reg["distortion"]
        for layout in ("orbit", "forward")
    )
    assert forward == config.reg["distortion"] and orbit.weight != forward.weight


def test_defaults_of_a_room_are_not_written(
    compose: Callable[..., Config], monkeypatch: pytest.MonkeyPatch
) -> None:
    defaults = {"orbit": {"weight": 2.0, "start": 0.5}, "room": {"weight": 3.0}}
    monkeypatch.setattr(RayEntropy, "by_layout", defaults)
    for layout, other in (("room", 2.0), ("object", 3.0)):
        config = compose("+reg=entropy", f"scene.layout={layout}")
        assert changed_settings(config, "entropy") == {}
        config = compose("+reg=entropy", f"scene.layout={layout}", f"reg.entropy.weight={other}")
        assert changed_settings(config, "entropy") == {"weight": other}


def test_instances_and_schedules_stay_what_they_are(compose: Callable[..., Config]) -> None:
    words = ("reg.kl.weight={schedule:cosine,from:1,to:0,start:0.1}", "reg.far.patch_fraction=0.5")
    config = compose("+reg=[kl,kl@far,entropy]", *words)
    write_preset(preset_path("both"), config, ("far", "kl"), ["of it."])
    again = compose("+reg=both").reg
    assert again == {name: config.reg[name] for name in ("far", "kl")}
    assert again["kl"].schedules == config.reg["kl"].schedules != {}
    assert changed_settings(config, "far") == {"patch_fraction": 0.5}


def test_nothing_left_is_vanilla(compose: Callable[..., Config]) -> None:
    write_preset(preset_path("nothing"), compose("+reg=kl"), (), ["of it."])
    assert compose("+reg=nothing").reg == {}


@pytest.mark.parametrize(
    ("scene", "name"),
    [
        ("fern", "fern"),
        ("procedural-orbit", "procedural_orbit"),
        ("my photos (2)", "my_photos_2"),
    ],
)
def test_names(scene: str, name: str) -> None:
    assert plain(scene) == name


def test_names_that_are_taken(compose: Callable[..., Config]) -> None:
    compose()
    for name in ("kl", "combinerf"):
        with pytest.raises(
            NerfregError, match=f"--name {name}: a plugin or preset of this name exists"
        ):
            preset_path(name)
    for name in ("a/b", "", "+x", "../up"):
        with pytest.raises(NerfregError, match="use letters, digits"):
            preset_path(name)


def test_a_preset_of_the_users_own_is_not_overwritten_but_ours_is(
    compose: Callable[..., Config],
) -> None:
    config = compose("+reg=kl")
    path = preset_path("mine")
    write_preset(path, config, ("kl",), ["of it."])
    assert preset_path("mine") == path
    path.write_text("defaults: [kl, _self_]\n")
    with pytest.raises(
        NerfregError, match=r"mine\.yaml: exists, and nerfreg prune did not write it"
    ):
        preset_path("mine")
