"""Which views train and which test: the papers' protocols by name, as pure functions of counts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nerfreg.errors import NerfregError
from nerfreg.scenes.checks import check_choice

Views = Sequence[int] | None

PROTOCOLS = ("llff", "nerf_synthetic_8", "every_8", "lists")
"""Names of the protocols; "llff" is another name of "every_8"."""

NERF_SYNTHETIC_TRAIN = (26, 86, 2, 55, 75, 93, 16, 73)
"""The training frames of the protocol with 8 views, in its order."""

NERF_SYNTHETIC_TESTS = 25
"""The number of test frames of that protocol, out of 200."""


class Split(NamedTuple):
    """Numbers of training and test views.

    Attributes:
        train: Training views, in the order in which the protocol names them.
        test: Test views.
    """

    train: tuple[int, ...]
    test: tuple[int, ...]


def evenly(items: Sequence[int], count: int | None) -> tuple[int, ...]:
    """Choose evenly spaced items, including the first and the last.

    Args:
        items: The items to choose from.
        count: How many to choose; None for all.

    Returns:
        The items at `round(linspace(0, len - 1, count))`.

    Raises:
        NerfregError: If there are fewer items than that.
    """
    count = _check_views(count, len(items))
    return tuple(items[int(i)] for i in np.round(np.linspace(0, len(items) - 1, count)))


def every_8(count: int, views: int | None = None) -> Split:
    """Test images 0, 8, 16, ..., and train evenly spaced ones among the others (LLFF's protocol).

    Args:
        count: Number of images.
        views: Number of training views; None for all the others.

    Returns:
        The split.

    Raises:
        NerfregError: If there are too few images.
    """
    test = tuple(range(0, count, 8))
    rest = [i for i in range(count) if i % 8]
    return _not_empty(Split(evenly(rest, views) if rest else (), test), "every_8")


def nerf_synthetic_8(train_count: int, test_count: int, views: int | None = None) -> Split:
    """Train the first of eight fixed frames, and test 25 evenly spaced frames.

    With more than eight views, or data without those frames, the training frames are evenly spaced.

    Args:
        train_count: Number of frames in the training file.
        test_count: Number of frames in the test file.
        views: Number of training views; None for eight, or all if there are fewer.

    Returns:
        The split, whose training and test views number the frames of two different files.

    Raises:
        NerfregError: If there are too few frames.
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
    """Split by explicit lists.

    Args:
        train: Training views; None for those of `default`.
        test: Test views; None for those of `default`.
        default: What to take where a list is missing.
        counts: Number of views that training and test views are chosen from.
        views: Number of training views, the first ones of the list; None for all.

    Returns:
        The split.

    Raises:
        NerfregError: If a view does not exist or appears twice in a list, or a list is empty.
    """
    # The lists may share views: of a handful of photographs there may be none to spare.
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
    """Split images that are numbered together.

    Args:
        name: The protocol; None for the lists if there are any, else `every_8`.
        count: Number of images.
        views: Number of training views; None for all that the protocol leaves.
        train: Training views for `lists`.
        test: Test views for `lists`.

    Returns:
        The split.

    Raises:
        NerfregError: If the protocol does not fit, or a number or list is wrong.
    """
    name = _protocol(name, "every_8", train, test)
    if name == "nerf_synthetic_8":
        raise NerfregError(
            "scene.split=nerf_synthetic_8: needs separate files of training and test frames; "
            "use every_8 or lists"
        )
    if name != "lists":
        return every_8(count, views)
    listed = {*(train or ()), *(test or ())}
    rest = tuple(i for i in range(count) if i not in listed)
    # Views that are left over after a list of test views are spread evenly, as in the protocols; of
    # a list of training views `lists` takes the first, in the order that the user gave.
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
    """Split frames that come in a training and a test file.

    Args:
        name: The protocol; None for the lists if there are any, else `nerf_synthetic_8`.
        counts: Number of frames in the training and in the test file.
        views: Number of training views; None for all that the protocol has.
        train: Training frames for `lists`.
        test: Test frames for `lists`.

    Returns:
        The split; the frames of each file are numbered from 0.

    Raises:
        NerfregError: If the protocol does not fit, or a number or list is wrong.
    """
    name = _protocol(name, "nerf_synthetic_8", train, test)
    if name in ("llff", "every_8"):
        raise NerfregError(
            f"scene.split={name}: these frames come in separate training and test files; "
            "use nerf_synthetic_8 or lists"
        )
    if name == "nerf_synthetic_8":
        return nerf_synthetic_8(*counts, views)
    # `views` shortens the list of training frames if there is one, and otherwise the default.
    default = nerf_synthetic_8(*counts, views if train is None else None)
    return lists(train, test, default, counts, views)


def hold_out(split: Split, positions: Sequence[int]) -> Split:
    """Hold out training views, and test these in place of all test views.

    Args:
        split: The split.
        positions: Which of the training views to hold out, as positions in their list.

    Returns:
        The split of the former training views.

    Raises:
        NerfregError: If a position does not exist, or none or all of them are named.
    """
    count = len(split.train)
    for position in positions:
        if not 0 <= position < count:
            raise NerfregError(
                f"scene.held_out={list(positions)}: the {count} training views are numbered "
                f"0 to {count - 1}"
            )
    train = tuple(view for position, view in enumerate(split.train) if position not in positions)
    if not (train and positions):
        raise NerfregError(
            f"scene.held_out={list(positions)}: must name some, but not all, of the {count} "
            "training views"
        )
    return Split(train, tuple(split.train[position] for position in sorted(set(positions))))


def _protocol(name: str | None, default: str, train: Views, test: Views) -> str:
    listed = train is not None or test is not None
    if name is None:
        return "lists" if listed else default
    check_choice("scene.split", name, PROTOCOLS)
    if listed and name != "lists":
        raise NerfregError(
            f"scene.split={name}: scene.train and scene.test are used with scene.split=lists only; "
            "leave out one or the other"
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
                f"scene.split={name}: no {key} view is left; there are too few images, "
                "or a list is empty"
            )
    return split
