"""The ruler: proves that a change of the code changed no number that a user sees. Run it by `bench/ruler.py`."""

import os

# One thread of linear algebra, before NumPy is loaded: sums are then taken in the same order on every run.
for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_library, "1")
