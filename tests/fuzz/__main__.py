"""``python -m tests.fuzz``: see `tests.fuzz.runner`."""

import os

# One thread: small cases are slower with more, and several fuzzers can run side by side.
for variable in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

from tests.fuzz.runner import main

raise SystemExit(main())
