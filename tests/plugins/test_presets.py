"""Presets compose, and what they change lands where it belongs."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import OmegaConf

from nerfreg.config.plugin_schema import plugin_schema
from nerfreg.config.schema import register
from nerfreg.errors import NerfregError
from nerfreg.hooks import Regularizer
from nerfreg.runs.citations import plugin_entries

CONF = Path(__file__).parents[2] / "conf"
CLASSES = {
    "adversarial": "Adversarial",
    "annealing": "Annealing",
    "convex_prior": "ConvexPrior",
    "depth_smoothness": "DepthSmoothness",
    "distortion": "Distortion",
    "encoding_mask": "EncodingMask",
    "entropy": "RayEntropy",
    "full_geometry": "FullGeometry",
    "kl": "KLDivergence",
    "lipschitz": "Lipschitz",
    "occlusion": "Occlusion",
    "silhouettes": "Silhouettes",
    "stereo": "Stereo",
    "unseen_smoothness": "UnseenSmoothness",
    "view_dependence": "ViewDependence",
}
FIRST = {"distortion", "full_geometry"}
GEOMETRY = FIRST | {"depth_smoothness"}
COMBINERF = GEOMETRY | {"lipschitz", "encoding_mask", "kl"}
PRESETS = {
    "vanilla": set(),
    "combinerf": COMBINERF,
    "combinerf_dagger": COMBINERF,
    "combinerf_sharp": COMBINERF,
    "combinerf_program": COMBINERF,
    "combinerf_plus": {"distortion", "occlusion", "unseen_smoothness", "view_dependence", "stereo"}
    | {"silhouettes", "convex_prior"},
    "ablation_lip": {"lipschitz"},
    "ablation_dist_fg": FIRST,
    "ablation_dist_fg_patch4": FIRST,
    "ablation_dist_fg_ds": GEOMETRY,
    "ablation_dist_fg_ds_lip": GEOMETRY | {"lipschitz"},
    "ablation_dist_fg_ds_lip_mask": GEOMETRY | {"lipschitz", "encoding_mask"},
    "ablation_dist_fg_ds_kl_infonerf_lip": GEOMETRY | {"kl", "lipschitz"},
}


@dataclass
class Stub:
    """A configuration of nothing but a scene's layout and the regularizers."""

    scene: dict[str, str] = field(default_factory=lambda: {"layout": "forward"})
    reg: dict[str, Any] = field(default_factory=dict)


def composed(*overrides: str) -> dict[str, Regularizer]:
    register()
    store = ConfigStore.instance()
    before = store.repo.pop("reg", {})
    try:
        store.store(name="stub", node=Stub)
        for name, cls in CLASSES.items():
            plugin = getattr(import_module(f"nerfreg_plugins.{name}"), cls)
            store.store(
                group="reg",
                name=name,
                node=plugin_schema(name, plugin),
                package=f"_global_.reg.{name}",
            )
        with initialize_config_dir(str(CONF), version_base="1.3"):
            return OmegaConf.to_object(compose("stub", list(overrides)).reg)
    finally:
        store.repo["reg"] = before
        GlobalHydra.instance().clear()


def test_every_preset_is_tested():
    assert {path.stem for path in (CONF / "reg").glob("*.yaml")} == set(PRESETS)


@pytest.mark.parametrize(("preset", "plugins"), PRESETS.items(), ids=PRESETS)
def test_plugins_of_each_preset(preset, plugins):
    reg = composed(f"+reg={preset}")
    assert set(reg) == plugins
    assert all(isinstance(plugin, Regularizer) for plugin in reg.values())


def test_options_that_presets_change():
    assert composed("+reg=combinerf_dagger")["kl"].density == "alphas"
    assert composed("+reg=ablation_dist_fg_ds_kl_infonerf_lip")["kl"].density == "alphas"
    assert composed("+reg=combinerf_sharp")["lipschitz"].networks == ["color"]
    assert composed("+reg=ablation_dist_fg_patch4")["full_geometry"].patch_size == 4
    program = composed("+reg=combinerf_program")
    assert (program["kl"].direction, program["kl"].weight) == ("reverse", 1e-5)
    assert (program["distortion"].max_rays, program["full_geometry"].start) == (250, 0.1)
    for layout, masked in (("forward", {"color"}), ("orbit", {"density", "color"})):
        mask = composed("+reg=combinerf_program", f"scene.layout={layout}")["encoding_mask"]
        assert (set(mask.networks), mask.initial, mask.fractional) == (masked, 0.1, True)


@pytest.mark.parametrize(
    ("layout", "expected"),
    # dist, fg, kl, ds, saturation: DESIGN.md's numbers for LLFF and NeRF-Synthetic
    [("forward", (2e-5, 1e-4, 1e-5, 0.1, 0.9)), ("orbit", (2e-3, 1e-3, 1e-5, 0.01, 0.2))],
)
def test_weights_follow_the_layout(layout, expected):
    reg = composed("+reg=combinerf", f"scene.layout={layout}")
    weights = [
        reg[name].weight for name in ("distortion", "full_geometry", "kl", "depth_smoothness")
    ]
    assert (*weights, reg["encoding_mask"].saturation) == expected


def test_what_the_user_says_wins_and_lists_of_plugins_work():
    reg = composed(
        "+reg=combinerf", "reg.distortion.weight=0.5", "reg.lipschitz.networks=[density]"
    )
    assert (reg["distortion"].weight, reg["lipschitz"].networks) == (0.5, ["density"])
    assert set(composed("+reg=[kl,occlusion]")) == {"kl", "occlusion"}
    assert set(composed("+reg=[combinerf,occlusion]")) == COMBINERF | {"occlusion"}


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("reg.kl.density=opacities", "'opacities', expected one of .weights, alphas."),
        ("reg.lipschitz.networks=[colour]", "'colour', expected one of .density, color."),
        ("reg.kl.weights=1", "weights"),
    ],
)
def test_what_no_schema_knows_is_refused(override, message):
    with pytest.raises(HydraException, match=re.escape(override.partition("=")[0])) as error:
        composed("+reg=combinerf", override)
    assert re.search(message, f"{error.value} {error.value.__cause__}")


def test_bad_values_are_refused_by_name():
    with pytest.raises(NerfregError, match=r"reg\.annealing\.initial"):
        composed("+reg=annealing", "reg.annealing.initial=0")


@pytest.mark.parametrize("name", CLASSES)
def test_every_plugin_says_what_it_is_and_whom_to_cite(name):
    cls = getattr(import_module(f"nerfreg_plugins.{name}"), CLASSES[name])
    entries = plugin_entries(name, cls)
    assert entries
    for entry in entries.values():
        assert entry.startswith(("@inproceedings{", "@article{", "@book{"))
        assert entry.count("{") == entry.count("}")
    assert not (cls.__doc__ or "").startswith(f"{cls.__name__}("), (
        "a dataclass without a docstring gets its signature"
    )
