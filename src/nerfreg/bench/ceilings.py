"""What the machine can do at best, and how much arithmetic a step asks for."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import nn

from nerfreg.bench.timing import in_turns
from nerfreg.field.radiance_field import RadianceField
from nerfreg.field.workers import in_shares, threads

ROWS, WIDTH = 4096, 64
"""The networks' matrix products: chunks of so many points, through layers so wide."""
PASSES = 3
"""Forward, the gradient of the weights and that of the input take one matrix product each."""


def measure_ceilings(square: int, copy_mb: int, repetitions: int = 5) -> dict[str, float]:
    """Return the best rates of the machine with all threads, of some repetitions after a warm-up.

    Args:
        square: Side of one large matrix product.
        copy_mb: Size of a large copy, which is read and written.
        repetitions: Of each measurement.

    Returns:
        GFLOP/s of products of 4096 x 64 x 64, one after the other on every thread, and of the large
        product, and GB/s of the copy.
    """
    count, products = threads(), max(square // WIDTH, 1) * 8
    a, b, product = (torch.rand(square, square) for _ in range(3))
    source, target = (torch.zeros(copy_mb * 2**18) for _ in range(2))

    def on_every_thread() -> None:
        in_shares(count * ROWS, ROWS, lambda start, stop: _multiply(stop - start, products))

    def rate(work: int, call: Callable[[], object]) -> float:
        return work / min(in_turns([call], repetitions + 1)[0][1:]) / 1e9

    network, large = product_flop(ROWS, WIDTH, WIDTH), product_flop(square, square, square)
    of_torch = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        return {
            "ceiling_network_gflops": rate(count * products * network, on_every_thread),
            "ceiling_square_gflops": rate(large, lambda: torch.mm(a, b, out=product)),
            "ceiling_bandwidth_gb_per_second": rate(
                2 * copy_mb * 2**20, lambda: target.copy_(source)
            ),
        }
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
