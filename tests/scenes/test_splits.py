from __future__ import annotations

import pytest

from nerfreg.errors import NerfregError
from nerfreg.scenes.splits import (
    NERF_SYNTHETIC_TRAIN,
    Split,
    choose_from_one,
    choose_from_two,
    evenly,
    every_8,
    hold_out,
    nerf_synthetic_8,
)


@pytest.mark.parametrize(
    ("count", "expected"),
    # round(linspace(0, 9, n)): 0; 0, 9; 0, 4.5 -> 4 (half to even), 9; 0, 3, 6, 9.
    [(1, (0,)), (2, (0, 9)), (3, (0, 4, 9)), (4, (0, 3, 6, 9)), (10, tuple(range(10)))],
)
def test_evenly(count, expected):
    assert evenly(range(10), count) == expected


def test_llff_protocol_on_fern():
    # 20 images: 0, 8, 16 test; 17 others, of which the 1st, 9th and 17th train: 1, 10, 19.
    assert every_8(20, 3) == Split((1, 10, 19), (0, 8, 16))
    assert every_8(20).train == tuple(i for i in range(20) if i not in (0, 8, 16))


def test_nerf_synthetic_protocol():
    # linspace(0, 199, 25) has step 199/24 = 8.2917: 0, 8.29, 16.58, 24.9, 33.2, ... 190.7, 199.
    split = nerf_synthetic_8(100, 200)
    assert split.train == (26, 86, 2, 55, 75, 93, 16, 73)
    assert len(split.test) == 25
    assert split.test[:5] == (0, 8, 17, 25, 33)
    assert split.test[-2:] == (191, 199)
    assert nerf_synthetic_8(100, 200, 3).train == (26, 86, 2)
    assert nerf_synthetic_8(100, 200, 100).train == tuple(range(100))
    # Without frame 93 the standard views do not exist.
    assert nerf_synthetic_8(93, 10, 2) == Split((0, 92), tuple(range(10)))
    assert nerf_synthetic_8(5, 10).train == (0, 1, 2, 3, 4)


def test_lists():
    assert choose_from_one(None, 10, None, [5, 1], [2]) == Split((5, 1), (2,))
    assert choose_from_one("lists", 10, 1, [5, 1], [2]) == Split((5,), (2,))
    assert choose_from_one(None, 4, None, [1], None) == Split((1,), (0, 2, 3))
    assert choose_from_one(None, 6, 2, None, [0]) == Split((1, 5), (0,))
    assert choose_from_one(None, 3, None, [0, 1, 2], [0]) == Split((0, 1, 2), (0,))
    assert choose_from_two(None, (100, 200), None, [1], None).train == (1,)
    assert choose_from_two(None, (100, 200), 2, None, [7]) == Split(NERF_SYNTHETIC_TRAIN[:2], (7,))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None, 20, 18, None, None), "scene.views=18: there are only 17"),
        ((None, 20, 0, None, None), "scene.views=0: must be at least 1"),
        (("evry_8", 20, None, None, None), "scene.split=evry_8: unknown; did you mean 'every_8'?"),
        ((None, 1, None, None, None), "no training view is left"),
        ((None, 10, None, [], [1]), "no training view is left"),
        ((None, 10, None, [1], []), "no test view is left"),
        ((None, 10, None, [10], [1]), "scene.train: view 10 does not exist; views are 0 to 9"),
        ((None, 10, None, [1], [-1]), "scene.test: view -1 does not exist"),
        ((None, 10, None, [1, 1], [2]), "a view appears twice"),
        ((None, 10, 2, [1], [2]), "scene.views=2: there are only 1"),
        (("llff", 10, None, [1], [2]), "scene.split=lists only"),
        (("lists", 10, None, None, None), "give scene.train and scene.test"),
        (("nerf_synthetic_8", 10, None, None, None), "needs separate files"),
    ],
)
def test_refused(arguments, message):
    with pytest.raises(NerfregError) as error:
        choose_from_one(*arguments)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_two_files_are_not_one_list():
    with pytest.raises(NerfregError, match="separate training and test files"):
        choose_from_two("every_8", (100, 200), None, None, None)
    with pytest.raises(NerfregError, match="only 100"):
        choose_from_two(None, (100, 200), 101, None, None)


def test_held_out_views_take_the_place_of_the_test_views():
    # Positions count in the list of training views, not among all images.
    assert hold_out(Split((1, 10, 19), (0, 8, 16)), [1]) == Split((1, 19), (10,))
    assert hold_out(Split((26, 86, 2), (100,)), [2, 0]) == Split((86,), (26, 2))


@pytest.mark.parametrize("positions", [[], [3], [-1], [0, 1, 2]])
def test_not_every_view_can_be_held_out(positions):
    with pytest.raises(NerfregError, match=r"scene\.held_out=\[.*3 training views"):
        hold_out(Split((1, 10, 19), (0, 8, 16)), positions)
