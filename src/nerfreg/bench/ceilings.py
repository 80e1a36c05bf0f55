"""What the machine can do at best, and how much arithmetic a step asks for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import nn

from nerfreg.bench.timing import in_turns
from nerfreg.field.radiance_field import RadianceField
from nerfreg.field.workers import in_shares, threads

ROWS, WIDTH = 4096, 64
"""The networks' matrix products: chunks of so many points, through layers so wide."""
PASSES = 3
"""Forward, the gradient of the weights and that of the input take one matrix product each."""


@dataclass(frozen=True)
class Ceilings:
    """The best rates of the machine, with all threads.

    Attributes:
        network_gflops: Products of 4096 x 64 x 64, one after the other on every thread.
        square_gflops: One large square product.
        bandwidth_gbs: Reading and writing, in a large copy, in GB/s.
    """

    network_gflops: float
    square_gflops: float
    bandwidth_gbs: float


def measure_ceilings(square: int, copy_mb: int, repetitions: int = 5) -> Ceilings:
    """Return the best of some repetitions.

    Args:
        square: Side of the large product.
        copy_mb: Size of what is copied.
        repetitions: After one that does not count.
    """
    count, products = threads(), max(square // WIDTH, 1) * 8
    a, b, product = (torch.rand(square, square) for _ in range(3))
    source, target = (torch.zeros(copy_mb * 2**18) for _ in range(2))

    def on_every_thread() -> None:
        in_shares(count * ROWS, ROWS, lambda start, stop: _multiply(stop - start, products))

    def giga_per_second(work: int, call: Callable[[], object]) -> float:
        return work / min(in_turns([call], repetitions + 1)[0][1:]) / 1e9

    of_torch = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        return Ceilings(
            giga_per_second(count * products * product_flop(ROWS, WIDTH, WIDTH), on_every_thread),
            giga_per_second(
                product_flop(square, square, square), lambda: torch.mm(a, b, out=product)
            ),
            giga_per_second(2 * copy_mb * 2**20, lambda: target.copy_(source)),
        )
    finally:
        torch.set_num_threads(of_torch)


def product_flop(rows: int, inner: int, columns: int) -> int:
    """Return the operations of a matrix product: one multiplication and one addition each."""
    return 2 * rows * inner * columns


def step_flop(field: RadianceField, points: float, colors: float) -> float:
    """Return the operations of both networks in a step with so many densities and colours.

    Only matrix products count, and every level of the grid counts as alive.
    """
    density, color = _weights(field.density_network), _weights(field.color_network)
    return 2 * PASSES * (points * density + colors * color)


def _weights(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters() if parameter.dim() == 2)


def _multiply(rows: int, times: int) -> None:
    x, weight, out = torch.rand(rows, WIDTH), torch.rand(WIDTH, WIDTH), torch.empty(rows, WIDTH)
    for _ in range(times):
        torch.mm(x, weight, out=out)
