"""Exact values for `kl`."""

from __future__ import annotations

from collections.abc import Sequence

from mpmath import exp, fsum, log, mpf


def kl_loss_of_logs(
    log_weights: Sequence[Sequence[mpf]], neighbor_log_weights: Sequence[Sequence[mpf]]
) -> mpf:
    """Return D(p || q) = sum p log(p / q) with q floored at 1e-10, mean over pairs.

    Args:
        log_weights: Of the rays, `(M, N)`; -inf where a weight is 0.
        neighbor_log_weights: Of their neighbours, `(M, N)`.
    """
    pairs = zip(log_weights, neighbor_log_weights, strict=True)
    return fsum(_of_pair(*pair) for pair in pairs) / max(len(log_weights), 1)


def _of_pair(ray: Sequence[mpf], neighbor: Sequence[mpf]) -> mpf:
    p, q = ([exp(x) for x in log_weights] for log_weights in (ray, neighbor))
    p_total, q_total = fsum(p), fsum(q)
    if p_total == 0 or q_total == 0:
        return mpf(0)
    floored = ((a / p_total, max(b / q_total, mpf(1e-10))) for a, b in zip(p, q, strict=True))
    return fsum(a * log(a / b) for a, b in floored if a > 0)
