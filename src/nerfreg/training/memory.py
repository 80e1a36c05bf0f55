"""Memory of the process: the allocator's treatment of large blocks, and the peak."""

from __future__ import annotations

import ctypes
import resource
import sys

# Parameters of mallopt, as glibc's malloc.h numbers them.
M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_MAX = -1, -2, -4


def keep_large_blocks() -> None:
    """Let glibc's allocator keep and reuse large blocks, which saves a fifth of a training step.

    By default every block above some megabytes is mapped anew and zeroed by the kernel, which takes
    longer than most of the operations that fill it. Does nothing with other C libraries.
    """
    if not sys.platform.startswith("linux"):
        return
    # Other C libraries of Linux, such as musl, have no mallopt.
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        # Large blocks come from the heap instead of mappings of their own, which end with the
        # block. The heap is returned to the kernel only beyond 2 GB of free memory at its end, and
        # grows by 64 MB at a time, so that steps soon find all their blocks there.
        mallopt(M_MMAP_MAX, 0)
        mallopt(M_TRIM_THRESHOLD, 2**31 - 1)
        mallopt(M_TOP_PAD, 64 * 2**20)


def peak_memory_mb() -> float:
    """Return the largest resident size of this process so far, in MiB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # macOS counts in bytes, Linux in KiB.
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10
