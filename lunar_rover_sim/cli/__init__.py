"""The command line: one command a file."""

import os

# Matrices here are small: OpenBLAS's second thread only waits for the first, at full load. NumPy
# reads this when it is imported, which is later.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
