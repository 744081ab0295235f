"""The estimator of one cell as an object file for a microcontroller: the kernel's source, compiled by LLVM, no Python.

`export` is all that is needed from outside.
"""

from __future__ import annotations

from bms_ukf.firmware.package import export

__all__ = ["export"]
