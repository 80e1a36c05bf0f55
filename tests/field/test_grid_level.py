"""Reading the table of a hash grid level by level, and where the gradients go."""

from __future__ import annotations

import copy
import pickle

import numba
import pytest
import torch
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.field import grid_torch
from nerfreg.field.grid import HashGrid
from nerfreg.field.grid_layout import GridLayout
from nerfreg.field.grid_shared import SharedTable

LAYOUT = GridLayout(levels=8, base=4, finest=64, log2_entries=10)
"""Cells 4, 5, 8, ... a side: the first three levels are dense, the other five hashed."""
BACKENDS = ("numba", "torch")


def grid(backend: str = "numba", dtype: torch.dtype = torch.float32) -> HashGrid:
    torch.manual_seed(0)
    made = HashGrid(LAYOUT, backend)
    torch.nn.init.normal_(made.table)
    return made.to(dtype)


def test_levels_describe_the_layout() -> None:
    levels = grid().tables
    assert [level.resolution for level in levels] == LAYOUT.resolutions.tolist()
    # (4+1)^3 = 125, (5+1)^3 = 216, (8+1)^3 = 729 fit into 2^10 entries, (13+1)^3 does not
    assert [level.entries for level in levels] == [125, 216, 729, *[1024] * 5]
    assert [level.dense for level in levels] == [True] * 3 + [False] * 5


@pytest.mark.parametrize("backend", BACKENDS)
def test_features_of_a_vertex_are_what_the_encoding_has_there(backend: str) -> None:
    made = grid(backend)
    for number, level in enumerate(made.tables):
        vertices = torch.randint(0, level.resolution + 1, (4, 5, 3))
        vertices[0, 0], vertices[0, 1] = 0, level.resolution
        # halfway into no cell: the position of a vertex, as exactly as float32 has it
        positions = (vertices.double() / level.resolution).float().view(-1, 3)
        encoded = made(positions, number + 1)[:, 2 * number :].view(4, 5, 2)
        features = level.features(vertices)
        torch.testing.assert_close(features, encoded, rtol=1e-4, atol=1e-4)
        torch.testing.assert_close(level.features(vertices.int()), features, rtol=0, atol=0)


def test_a_dense_level_is_stored_fastest_in_x() -> None:
    level = grid().tables[1]
    side, vertex = 6, torch.tensor([1, 2, 3])
    assert torch.equal(level.features(vertex), level.table[1 + side * (2 + side * 3)])


@pytest.mark.parametrize("log2_entries", [10, 19])
def test_compiled_and_plain_find_the_same_entries(log2_entries: int) -> None:
    # up to the finest resolution that a configuration may have, where products exceed 32 bits
    layout = GridLayout(levels=4, base=16, finest=65536, log2_entries=log2_entries)
    compiled, plain = HashGrid(layout), HashGrid(layout, "torch")
    plain.load_state_dict(compiled.state_dict())
    for one, other in zip(compiled.tables, plain.tables, strict=True):
        vertices = torch.randint(0, one.resolution + 1, (1000, 3))
        vertices[0] = one.resolution
        assert torch.equal(one.features(vertices), other.features(vertices))
        vertices = vertices.clamp_max(one.resolution - 1)
        torch.testing.assert_close(
            one.squared_differences(vertices), other.squared_differences(vertices)
        )


@pytest.mark.parametrize("backend", BACKENDS)
def test_squared_differences_are_those_of_four_lookups(backend: str) -> None:
    made = grid(backend)
    for level in made.tables:
        vertices = torch.randint(0, level.resolution, (6, 50, 3))
        vertices[0, :25] = vertices[0, 25:]
        found = level.features(vertices[..., None, :] + torch.eye(4, dtype=torch.int64)[:, 1:])
        by_hand = (found[..., 1:, :] - found[..., :1, :]).square().sum(dim=(-1, -2))
        values = level.squared_differences(vertices)
        torch.testing.assert_close(values, by_hand)
        weights = torch.randn(6, 50)
        torch.testing.assert_close(
            *(torch.autograd.grad(v, made.table, weights)[0] for v in (values, by_hand)),
            rtol=1e-5,
            atol=1e-4,
        )
        int32 = level.squared_differences(vertices.int())
        assert torch.equal(int32, values)


def test_lookups_are_the_same_for_any_number_of_threads() -> None:
    made, vertices = grid(), torch.randint(0, 64, (3001, 3))

    def with_threads(count: int) -> list[Tensor]:
        before = numba.get_num_threads()
        numba.set_num_threads(count)
        try:
            level = made.tables[7]
            values = [level.features(vertices), level.squared_differences(vertices)]
            total = values[0].square().sum() + values[1].sum()
            return [*values, *torch.autograd.grad(total, made.table)]
        finally:
            numba.set_num_threads(before)

    alone, together = with_threads(1), with_threads(numba.config.NUMBA_NUM_THREADS)
    assert all(torch.equal(*pair) for pair in zip(alone, together, strict=True))


def losses(made: HashGrid, positions: Tensor, vertices: Tensor) -> dict[str, Tensor]:
    """A loss of each kind by what it reads: encodings, entries, whole levels, the parameter."""
    levels = made.tables
    with made.one_gradient():
        first, second = made(positions, 8), made(positions.flip(0), 5)
    found = [level.features(vertices % (level.resolution + 1)) for level in levels]
    return {
        "encodings": first.square().sum() + second.sum(),
        "entries": sum((f.square().sum() for f in found), start=torch.zeros(())),
        # twice the same level, and one that overlaps nothing
        "levels": levels[2].table.square().sum() + (levels[2].table * levels[0].table[0]).sum(),
        "parameter": made.table.pow(3).sum(),
    }


@pytest.mark.parametrize("backend", BACKENDS)
def test_gradients_of_all_readers_add_up(backend: str) -> None:
    torch.manual_seed(1)
    positions = torch.rand(200, 3)
    # Every vertex twice: an entry gets the sum of what its lookups get.
    vertices = torch.randint(0, 65, (100, 3)).repeat(2, 1)
    made = grid(backend)
    parts = {
        name: torch.autograd.grad(
            losses(made, positions, vertices)[name], made.table, allow_unused=True
        )[0]
        for name in ("encodings", "entries", "levels", "parameter")
    }
    # one by one, as autograd indexes the parameter
    entries, level_two = made.table.detach().clone().requires_grad_(), LAYOUT.offsets[2:4]
    plain = torch.zeros(())
    for level in range(8):
        start = int(LAYOUT.offsets[level])
        inside = vertices % (int(LAYOUT.resolutions[level]) + 1)
        plain = plain + entries[grid_torch.entries(inside, LAYOUT, level) + start].square().sum()
    torch.testing.assert_close(parts["entries"], torch.autograd.grad(plain, entries)[0])
    two = entries[level_two[0] : level_two[1]]
    plain = two.square().sum() + (two * entries[0]).sum()
    torch.testing.assert_close(parts["levels"], torch.autograd.grad(plain, entries)[0])
    # all in one backward pass, in either order of the sum
    for order in (list, lambda values: list(reversed(list(values)))):
        total = torch.stack(order(losses(made, positions, vertices).values())).sum()
        torch.testing.assert_close(
            torch.autograd.grad(total, made.table)[0], torch.stack([*parts.values()]).sum(dim=0)
        )
    # in two passes, into .grad
    several = losses(made, positions, vertices)
    (several["encodings"] + several["entries"]).backward()
    (several["levels"] + several["parameter"]).backward()
    assert made.table.grad is not None
    torch.testing.assert_close(made.table.grad, torch.stack([*parts.values()]).sum(dim=0))


def test_lookups_of_a_step_make_one_buffer_with_the_encodings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, created = grid(), []
    buffer = SharedTable.buffer

    def counted(self: SharedTable) -> tuple[Tensor, bool]:
        result = buffer(self)
        created.append(result[1])
        return result

    monkeypatch.setattr(SharedTable, "buffer", counted)
    several = losses(made, torch.rand(10, 3), torch.randint(0, 65, (10, 3)))
    torch.stack([several[name] for name in ("encodings", "entries", "levels")]).sum().backward()
    # two encodings, eight lookups, three uses of tables: 13 additions to one buffer
    assert len(created) == 13 and sum(created) == 1


def test_lookups_follow_the_parameter_through_steps() -> None:
    made = grid("auto")
    levels, vertex = made.tables, torch.tensor([[1, 2, 3]])
    optimizer = torch.optim.SGD(made.parameters(), lr=0.25)
    for _ in range(3):
        before = levels[4].features(vertex).detach()
        optimizer.zero_grad()
        # gradient 2 f, step of a quarter: halves what it has read
        levels[4].features(vertex).square().sum().backward()
        optimizer.step()
        torch.testing.assert_close(levels[4].features(vertex).detach(), before / 2)
    made.double()
    moved = levels[4].features(vertex)
    assert moved.dtype == torch.float64
    torch.testing.assert_close(moved.detach().float(), before / 2)


def test_a_frozen_table_is_read_without_gradient_and_comes_back() -> None:
    made, vertex = grid(), torch.tensor([1, 2, 3])
    made.tables[3].features(vertex).sum().backward()
    made.table.requires_grad_(False)
    assert not made.tables[3].features(vertex).requires_grad
    made.table.requires_grad_(True)
    assert made.tables[3].features(vertex).requires_grad
    with torch.no_grad():
        assert not made.tables[3].features(vertex).requires_grad
        made.tables[3].table.zero_()
    first, stop = LAYOUT.offsets[3:5]
    assert not made.table[first:stop].any() and made.table[:first].all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_second_derivatives_by_lookups(backend: str) -> None:
    # The gradient of the sum of cubes, 3 f^2, summed up and differentiated again: 6 f per use.
    made, vertices = grid(backend), torch.tensor([[1, 2, 3], [1, 2, 3], [4, 0, 4]])
    level = made.tables[0]
    cubes = level.features(vertices).pow(3).sum() + level.table.pow(3).sum()
    (first,) = torch.autograd.grad(cubes, made.table, create_graph=True)
    (second,) = torch.autograd.grad(first.sum(), made.table)
    rows = grid_torch.entries(vertices, LAYOUT, 0)
    # each lookup of an entry, and the whole level once
    uses = 1 + torch.bincount(rows, minlength=level.entries)
    table = made.table.detach()
    torch.testing.assert_close(second[: level.entries], 6 * table[: level.entries] * uses[:, None])
    assert not second[level.entries :].any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_vertices_outside_of_the_grid_are_refused(backend: str) -> None:
    level = grid(backend).tables[2]
    for vertex in ([-1, 0, 0], [0, 9, 0], [0, 0, 2**32]):
        with pytest.raises(NerfregError, match="must have coordinates 0 to 8 here, not"):
            level.features(torch.tensor([vertex]))
    with pytest.raises(NerfregError, match=r"0 to 7 here, not 0 to 8: .* has 8 cells per side"):
        level.squared_differences(torch.tensor([[0, 8, 0]]))
    nothing = torch.zeros(0, 3, dtype=torch.int64)
    assert level.features(nothing).shape == (0, 2)
    assert level.squared_differences(nothing).shape == (0,)


def test_a_grid_with_a_shared_table_can_be_copied_and_pickled() -> None:
    made = grid()
    made.tables[0].features(torch.tensor([1, 1, 1])).sum()
    for other in (copy.deepcopy(made), pickle.loads(pickle.dumps(made))):
        assert torch.equal(other.table, made.table)
        other.tables[0].features(torch.tensor([1, 1, 1])).sum().backward()
        assert other.table.grad is not None and made.table.grad is None


def test_a_backward_pass_that_fails_leaves_nothing_for_the_next() -> None:
    made, vertex = grid(), torch.tensor([[1, 2, 3]])
    level = made.tables[5]
    # The node that was made last runs first: that of the lookup has added its gradient when the
    # other fails, and that of the shared table, which hands the gradient on, has not run.
    level.features(vertex)
    broken = torch.ones((), requires_grad=True) * 1

    def fail(grad: Tensor) -> None:
        raise RuntimeError("broken")

    broken.register_hook(fail)
    with pytest.raises(RuntimeError, match="broken"):
        (broken + level.features(vertex).sum()).backward()
    assert made.table.grad is None
    level.features(vertex).sum().backward()
    assert made.table.grad is not None and made.table.grad.sum() == 2
