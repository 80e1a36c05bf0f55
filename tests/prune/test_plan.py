from __future__ import annotations

import pytest

from nerfreg.errors import NerfregError
from nerfreg.prune.plan import Context, Design, Stage, Trial, make_folds, make_ladder


@pytest.mark.parametrize(
    ("views", "count", "folds"),
    [
        (2, None, ((0,), (1,))),
        (3, None, ((0,), (1,), (2,))),
        (8, None, ((0, 4), (1, 5), (2, 6), (3, 7))),
        (9, None, ((0, 4, 8), (1, 5), (2, 6), (3, 7))),
        (5, 2, ((0, 2, 4), (1, 3))),
        (5, 5, ((0,), (1,), (2,), (3,), (4,))),
    ],
)
def test_folds(views: int, count: int | None, folds: tuple[tuple[int, ...], ...]) -> None:
    assert make_folds(views, count) == folds
    assert sorted(sum(folds, ())) == list(range(views))


@pytest.mark.parametrize("count", [1, 4])
def test_folds_that_cannot_be(count: int) -> None:
    with pytest.raises(NerfregError, match=f"--folds {count}: 3 training views make 2 to 3 folds"):
        make_folds(3, count)


@pytest.mark.parametrize(
    ("first", "last", "ladder"),
    [
        (None, 1500, (375, 750, 1500)),
        (None, 3, (1, 2, 3)),
        (None, 1, (1,)),
        (100, 250, (100, 200, 250)),
        (250, 250, (250,)),
    ],
)
def test_ladder(first: int | None, last: int, ladder: tuple[int, ...]) -> None:
    assert make_ladder(first, last) == ladder


def test_ladder_longer_than_a_run() -> None:
    with pytest.raises(NerfregError, match=r"--steps 300: more than train\.steps=200"):
        make_ladder(300, 200)


@pytest.mark.parametrize("last", [None, 0, -4])
def test_ladder_without_steps(last: int | None) -> None:
    with pytest.raises(NerfregError, match=rf"train\.steps={last}: prune compares"):
        make_ladder(None, last)


def test_cells_go_round_the_folds_seed_by_seed() -> None:
    design = Design(("a",), ((0,), (1,), (2,)), (10,), seed=5)
    assert design.cells(4) == [((0,), 5), ((1,), 5), ((2,), 5), ((0,), 6)]


@pytest.mark.parametrize(("folds", "first"), [(2, 4), (3, 6), (4, 4), (5, 5)])
def test_the_first_look_takes_whole_rounds_of_four_cells_or_more(folds: int, first: int) -> None:
    assert Design(("a",), make_folds(folds, None if folds < 5 else 5), (10,)).first_look == first


def test_pairs_differ_in_one_regularizer() -> None:
    design = Design(("a", "b", "c"), ((0,), (1,)), (10,))
    assert design.pair("b", Context.SET) == (("a", "b", "c"), ("a", "c"))
    assert design.pair("b", Context.ALONE) == (("b",), ())


def test_trials_go_cell_by_cell_and_each_begins_with_another_set() -> None:
    design = Design(("a", "b"), ((0,), (1,)), (10,))
    pairs = [design.pair("a", Context.SET), design.pair("b", Context.ALONE)]
    # The full set and vanilla stand first, the set without a, which is b alone, behind them.
    full, vanilla, b = ("a", "b"), (), ("b",)
    assert design.trials(pairs, Stage(10, 2)) == [
        *(Trial(names, (0,), 0, 10) for names in (full, vanilla, b)),
        *(Trial(names, (1,), 0, 10) for names in (vanilla, b, full)),
    ]
    assert design.trials([], Stage(10, 2)) == []


def test_labels() -> None:
    design = Design(("a", "b", "c", "d"), ((0,), (1,)), (10,))
    sets = (("a", "b", "c", "d"), (), ("a", "c", "d"), ("c",), ("b", "d"))
    assert [design.label(names) for names in sets] == [
        "full set",
        "vanilla",
        "without b",
        "c alone",
        "b+d",
    ]
    assert Design(("a",), ((0,), (1,)), (10,)).label(()) == "vanilla"
