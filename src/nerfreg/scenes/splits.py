"""Which views train and which test: the protocols of the papers by name, as pure functions of counts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nerfreg.errors import NerfregError
from nerfreg.scenes.checks import check_choice

Views = Sequence[int] | None

PROTOCOLS = ("llff", "nerf_synthetic_8", "every_8", "lists")
NERF_SYNTHETIC_TRAIN = (26, 86, 2, 55, 75, 93, 16, 73)
NERF_SYNTHETIC_TESTS = 25


class Split(NamedTuple):
    """View numbers. Training views keep the order in which the protocol names them."""

    train: tuple[int, ...]
    test: tuple[int, ...]


def evenly(items: Sequence[int], count: int | None) -> tuple[int, ...]:
    """`count` of the items, evenly spaced, first and last included: `round(linspace(0, len - 1, count))`."""
    count = _check_views(count, len(items))
    return tuple(items[int(i)] for i in np.round(np.linspace(0, len(items) - 1, count)))


def every_8(count: int, views: int | None = None) -> Split:
    """Images 0, 8, 16, ... test; `views` of the others, evenly spaced, train (None: all of them)."""
    test = tuple(range(0, count, 8))
    rest = [i for i in range(count) if i % 8]
    return _not_empty(Split(evenly(rest, views) if rest else (), test), "every_8")


def nerf_synthetic_8(train_count: int, test_count: int, views: int | None = None) -> Split:
    """The first `views` of eight fixed training frames, and 25 test frames evenly spaced.

    More than eight views, or data without those frames: training frames evenly spaced.
    train and test number the frames of two different files.
    """
    standard = train_count > max(NERF_SYNTHETIC_TRAIN)
    if standard and (views is None or views <= len(NERF_SYNTHETIC_TRAIN)):
        train = NERF_SYNTHETIC_TRAIN[: _check_views(views, len(NERF_SYNTHETIC_TRAIN))]
    else:
        wanted = min(len(NERF_SYNTHETIC_TRAIN), train_count) if views is None else views
        train = evenly(range(train_count), wanted)
    test = evenly(range(test_count), min(NERF_SYNTHETIC_TESTS, test_count))
    return _not_empty(Split(train, test), "nerf_synthetic_8")


def lists(
    train: Views, test: Views, default: Split, counts: tuple[int, int], views: int | None
) -> Split:
    """Explicit lists; one that is None is taken from `default`. `views` takes the first of the training list.

    The lists may share views: with a handful of photographs there may be none to spare.
    """
    split = Split(
        default.train if train is None else _check_list("train", train, counts[0]),
        default.test if test is None else _check_list("test", test, counts[1]),
    )
    return _not_empty(
        Split(split.train[: _check_views(views, len(split.train))], split.test), "lists"
    )


def choose_from_one(
    name: str | None, count: int, views: int | None, train: Views = None, test: Views = None
) -> Split:
    """The split of `count` images that lie together. name None: the lists if there are any, else `every_8`."""
    name = _protocol(name, "every_8", train, test)
    if name == "nerf_synthetic_8":
        raise NerfregError(
            "scene.split=nerf_synthetic_8: needs separate files of training and test frames; use every_8 or lists"
        )
    if name != "lists":
        return every_8(count, views)
    listed = {*(train or ()), *(test or ())}
    rest = tuple(i for i in range(count) if i not in listed)
    if train is None and test is not None:
        rest = evenly(rest, views)
    return lists(train, test, Split(rest, rest), (count, count), views)


def choose_from_two(
    name: str | None,
    counts: tuple[int, int],
    views: int | None,
    train: Sequence[int] | None,
    test: Sequence[int] | None,
) -> Split:
    """The split of frames that come as training and test frames (`counts` of each), each numbered from 0."""
    name = _protocol(name, "nerf_synthetic_8", train, test)
    if name in ("llff", "every_8"):
        raise NerfregError(
            f"scene.split={name}: these frames come in separate training and test files; use nerf_synthetic_8 or lists"
        )
    if name == "nerf_synthetic_8":
        return nerf_synthetic_8(*counts, views)
    default = nerf_synthetic_8(*counts, views if train is None else None)
    return lists(train, test, default, counts, views)


def hold_out(split: Split, positions: Sequence[int]) -> Split:
    """The training views at these positions of their list test, in place of all test views; the others train."""
    count = len(split.train)
    for position in positions:
        if not 0 <= position < count:
            raise NerfregError(
                f"scene.held_out={list(positions)}: the {count} training views are numbered 0 to {count - 1}"
            )
    train = tuple(view for position, view in enumerate(split.train) if position not in positions)
    if not (train and positions):
        raise NerfregError(
            f"scene.held_out={list(positions)}: must name some, not all, of the {count} training views"
        )
    return Split(train, tuple(split.train[position] for position in sorted(set(positions))))


def _protocol(name: str | None, default: str, train: Views, test: Views) -> str:
    listed = train is not None or test is not None
    if name is None:
        return "lists" if listed else default
    check_choice("scene.split", name, PROTOCOLS)
    if listed and name != "lists":
        raise NerfregError(
            f"scene.split={name}: scene.train and scene.test are read with scene.split=lists only"
        )
    if name == "lists" and not listed:
        raise NerfregError(
            "scene.split=lists: give scene.train and scene.test, e.g. 'scene.train=[1,5,9]'"
        )
    return name


def _check_views(views: int | None, available: int) -> int:
    if views is None:
        return available
    if views < 1:
        raise NerfregError(f"scene.views={views}: must be at least 1")
    if views > available:
        raise NerfregError(
            f"scene.views={views}: there are only {available} training views to choose from"
        )
    return views


def _check_list(key: str, values: Sequence[int], count: int) -> tuple[int, ...]:
    for value in values:
        if not 0 <= value < count:
            raise NerfregError(
                f"scene.{key}: view {value} does not exist; views are 0 to {count - 1}"
            )
    if len(set(values)) < len(values):
        raise NerfregError(f"scene.{key}={list(values)}: a view appears twice")
    return tuple(values)


def _not_empty(split: Split, name: str) -> Split:
    for key, views in (("training", split.train), ("test", split.test)):
        if not views:
            raise NerfregError(
                f"scene.split={name}: no {key} view is left; there are too few images, or a list is empty"
            )
    return split
