"""What the machine can do at best, and how much arithmetic a step asks for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import torch
from torch import nn

from nerfreg.field.radiance_field import RadianceField
from nerfreg.field.workers import in_shares, threads

ROWS, WIDTH = 4096, 64
"""The networks' matrix products: chunks of so many points, through layers so wide."""
PASSES = 3
"""Forward, the gradient of the weights and that of the input take one matrix product each."""


@dataclass(frozen=True)
class Ceilings:
    """network_gflops: float32 matrix products of 4096 x 64 x 64, one after the other on every thread.
    square_gflops: one large square product on all threads. bandwidth_gbs: reading and writing, in a large copy."""

    network_gflops: float
    square_gflops: float
    bandwidth_gbs: float


def measure_ceilings(square: int, copy_mb: int, repetitions: int = 5) -> Ceilings:
    """The best of some repetitions with all threads. square: side of the large product. copy_mb: what is copied."""
    count = threads()
    products = max(square // WIDTH, 1) * 8

    def on_every_thread() -> None:
        in_shares(count * ROWS, ROWS, lambda start, stop: _multiply(stop - start, products))

    a, b, product = (torch.rand(square, square) for _ in range(3))
    source, target = (torch.zeros(copy_mb * 2**18) for _ in range(2))
    of_torch = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        return Ceilings(
            count
            * products
            * product_flop(ROWS, WIDTH, WIDTH)
            / _best(on_every_thread, repetitions)
            / 1e9,
            product_flop(square, square, square)
            / _best(lambda: torch.mm(a, b, out=product), repetitions)
            / 1e9,
            2 * copy_mb * 2**20 / _best(lambda: target.copy_(source), repetitions) / 1e9,
        )
    finally:
        torch.set_num_threads(of_torch)


def product_flop(rows: int, inner: int, columns: int) -> int:
    """Floating point operations of a matrix product: one multiplication and one addition each."""
    return 2 * rows * inner * columns


def step_flop(field: RadianceField, points: float, colors: float) -> float:
    """Floating point operations of both networks in a training step that evaluates so many densities and colours.

    Matrix products alone, and as if every level of the grid were alive.
    """
    return (
        PASSES
        * (points * _weights(field.density_network) + colors * _weights(field.color_network))
        * 2
    )


def _weights(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters() if parameter.dim() == 2)


def _multiply(rows: int, times: int) -> None:
    x, weight, out = torch.rand(rows, WIDTH), torch.rand(WIDTH, WIDTH), torch.empty(rows, WIDTH)
    for _ in range(times):
        torch.mm(x, weight, out=out)


def _best(call: Callable[[], object], repetitions: int) -> float:
    seconds = []
    for _ in range(repetitions + 1):
        begun = perf_counter()
        call()
        seconds.append(perf_counter() - begun)
    return min(seconds[1:])
