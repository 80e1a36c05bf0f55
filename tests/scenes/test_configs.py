from __future__ import annotations

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from nerfreg.errors import NerfregError
from nerfreg.scenes import LLFF, SCENES

CONF = Path(__file__).parents[2] / "conf" / "scene"


@pytest.mark.parametrize("name", SCENES)
def test_shipped_values_fit_the_schema(name):
    values = OmegaConf.load(CONF / f"{name}.yaml")
    schema, *_, own = values.pop("defaults")
    assert (schema.removesuffix("@scene"), own) == (f"{name}_schema", "_self_")
    values = values.get("scene", values)
    config = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(SCENES[name]), values))
    assert type(config) is SCENES[name]


def test_every_field_can_be_set_from_the_command_line(llff):
    overrides = [
        f"path={llff}",
        "views=1",
        "split=lists",
        "train=[1,2]",
        "test=[0]",
        "layout=forward",
        "background=black",
        "near=1",
        "far=20",
        "box=[[-1,-1,-9],[1,1.5,0]]",
        "factor=10",
    ]
    merged = OmegaConf.merge(OmegaConf.structured(LLFF), OmegaConf.from_dotlist(overrides))
    scene = OmegaConf.to_object(merged).load()
    assert (scene.train, scene.test, scene.near, scene.far) == ((1,), (0,), 1.0, 20.0)
    assert scene.box.tolist() == [[-1, -1, -9], [1, 1.5, 0]]


def test_path_is_needed():
    config = OmegaConf.to_object(OmegaConf.structured(LLFF))
    with pytest.raises(NerfregError, match=r"scene\.path: not set"):
        config.load()
