"""Kinds of capture: how they are told apart, what depends on them, and what is said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import torch

from nerfreg.scenes import Blender, Procedural, Transforms
from nerfreg.scenes.bounds import orbit_box
from nerfreg.scenes.layouts import KINDS, LOOKED_AT, defaults_of, kind_of_orbit, said

OLD = {"forward": {"weight": 1}, "orbit": {"weight": 2, "start": 3}}
"""Defaults of a plugin that knows two layouts."""


@pytest.mark.parametrize(
    ("layout", "by_layout", "expected"),
    [
        ("forward", OLD, {"weight": 1}),
        ("object", OLD, {"weight": 2, "start": 3}),
        ("room", OLD, {"weight": 2, "start": 3}),
        ("orbit", OLD, {"weight": 2, "start": 3}),
        ("object", OLD | {"room": {"weight": 4}}, {"weight": 2, "start": 3}),
        ("room", OLD | {"room": {"weight": 4}}, {"weight": 4, "start": 3}),
        ("room", {"room": {"weight": 4}} | OLD, {"weight": 4, "start": 3}),
        ("object", {"object": {"end": 5}, "room": {"weight": 4}}, {"end": 5}),
        ("orbit", {"object": {"end": 5}, "room": {"weight": 4}}, {"end": 5}),
        ("forward", {"object": {"end": 5}, "room": {"weight": 4}}, {}),
        (None, OLD, {}),
        ("spiral", OLD, {}),
    ],
)
def test_a_kind_wins_over_orbit(layout: str | None, by_layout: dict, expected: dict) -> None:
    assert defaults_of(layout, by_layout) == expected


def test_an_alpha_channel_that_is_opaque_everywhere_shows_no_silhouette() -> None:
    opened: list[int] = []

    def read(view: int) -> torch.Tensor:
        opened.append(view)
        image = torch.ones(2, 3, 4)
        image[1, 2, 3] = 0.5 if view in transparent else 1.0
        return image

    transparent: set[int] = set()
    assert kind_of_orbit(False, (3, 1), read) == "room" and opened == []
    assert kind_of_orbit(True, (3, 1), read) == "room" and opened == [3, 1]
    opened.clear()
    assert kind_of_orbit(True, range(100), read) == "room"
    assert len(opened) == LOOKED_AT and {0, 99} < {*opened}
    transparent = {3}
    assert kind_of_orbit(True, (3, 1), read) == "object"
    transparent = {1}
    assert kind_of_orbit(True, (3, 1), read) == "object"


def test_silhouettes_are_found_in_the_first_image() -> None:
    opened: list[int] = []

    def read(view: int) -> torch.Tensor:
        opened.append(view)
        return torch.zeros(1, 1, 4)

    assert kind_of_orbit(True, range(100), read) == "object" and opened == [0]


@pytest.mark.parametrize(
    ("channels", "alpha", "kind"), [(4, None, "object"), (3, None, "room"), (4, 1.0, "room")]
)
def test_objects_and_rooms_are_told_apart_by_alpha(
    capture: Callable[..., Path], channels: int, alpha: float | None, kind: str
) -> None:
    path = str(capture(channels, alpha))
    for layout in (None, "orbit"):
        scene = Transforms(path=path, layout=layout, train=[0, 1, 2, 3]).load()
        assert scene.layout == scene.info.layout == kind
        assert scene.layout_found and scene.around and scene.info.around
    named = Transforms(path=path, layout=kind, train=[0, 1, 2, 3]).load()
    assert not named.layout_found
    assert torch.equal(named.box, scene.box) and (named.near, named.far) == (scene.near, scene.far)


def test_the_box_follows_the_kind_and_not_alpha(capture: Callable[..., Path]) -> None:
    path = str(capture(3))
    scenes = {
        layout: Transforms(path=path, layout=layout, train=[0, 1, 2, 3]).load() for layout in KINDS
    }
    cameras, train = scenes["object"].cameras, scenes["object"].train
    assert torch.equal(scenes["object"].box, orbit_box(cameras, train, 1.0))
    assert torch.equal(scenes["room"].box, orbit_box(cameras, train, 4.0))
    assert scenes["object"].near > scenes["room"].near
    assert not scenes["forward"].around and not scenes["forward"].info.around
    assert all(scene.background is None for scene in scenes.values())


def test_frames_of_nerf_synthetic_without_alpha_are_a_room(blender: Path) -> None:
    assert Blender(path=str(blender)).load().layout == "object"
    for image in blender.rglob("*.png"):
        iio.imwrite(image, np.full((8, 8, 3), 128, np.uint8))
    assert Blender(path=str(blender)).load().layout == "room"
    assert Blender(path=str(blender), layout="object").load().layout == "object"


def test_a_name_costs_no_image(capture: Callable[..., Path]) -> None:
    folder = capture(4)
    for image in folder.glob("*.png"):
        # The header stays.
        image.write_bytes(image.read_bytes()[:60])
    assert Transforms(path=str(folder), layout="object", train=[0, 1]).load().layout == "object"


def test_procedural_objects_keep_their_name() -> None:
    for layout in (None, "orbit", "object"):
        scene = Procedural(layout=layout, size=8).load()
        assert (scene.layout, scene.name) == ("object", "procedural-orbit")
        assert not scene.layout_found
    assert Procedural(layout="forward", size=8).load().name == "procedural-forward"


def test_the_line_names_the_other_kinds() -> None:
    assert said("object77", "room") == (
        "object77: room (opaque photographs around a place); "
        "scene.layout=forward or object overrides"
    )
