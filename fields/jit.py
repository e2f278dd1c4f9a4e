"""How this package compiles its kernels: one set of options, in one place.

Kernels are cached on disk beside their module (or where NUMBA_CACHE_DIR says), so that only the
first process after an installation compiles them.

A kernel's file is renewed when the kernel's own module changes, and not when a function that it
uses from another module does: after such a change delete the `.nbi` files (`make clean` does).
"""

from __future__ import annotations

import os

import numba

# OpenMP first: it allows calls from several Python threads, which "workqueue" does not, and asking
# for TBB first warns wherever another package has brought an old one.
# A process that was forked after kernels ran cannot run them: start workers by "spawn".
if "NUMBA_THREADING_LAYER_PRIORITY" not in os.environ:
    numba.config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]

REORDERING = {"contract", "nsz"}
"""Floating-point freedoms of the point kernels: fused multiply-add, and no care for signed zeros.
Neither reassociates sums, so results do not depend on how a loop is vectorised."""

kernel = numba.njit(cache=True, nogil=True, error_model="numpy")
"""A compiled function."""

parallel_kernel = numba.njit(cache=True, nogil=True, error_model="numpy", parallel=True)
"""A compiled function whose `prange` loops run on threads."""

point_kernel = numba.njit(
    cache=True, nogil=True, error_model="numpy", parallel=True, fastmath=REORDERING
)
"""The same with the freedoms above, for loops over points that should vectorise."""

inlined = numba.njit(inline="always")
"""A piece of a kernel, compiled into its caller under the caller's options."""

piece = numba.njit(nogil=True, error_model="numpy")
"""A compiled function for use in kernels only, in whose files on disk it is contained."""

accurate = numba.njit(nogil=True, error_model="numpy", fastmath={"contract"})
"""The same, free to fuse multiplications with additions, whatever its caller may do."""
