"""Compiled functions (kernels), kept on disk so that only the first run on a machine compiles them.

numba's own cache does not notice when a function that a kernel calls has changed in another file, mixes up what two
processes write at the same time, and fails where no directory can be written. This one keeps a file for each kernel
and signature. The file's name holds a digest of everything that the machine code follows from (`digest.py`), and the
file holds its own checksum (`store.py`). So stale code is not found, and damaged code is not used.
"""

from crowdbench.utils.compiled.kernel import njit, on_first_compilation, prange

__all__ = ["njit", "on_first_compilation", "prange"]
