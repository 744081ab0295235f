"""The estimator as a co-simulation FMU: `firmware`'s object file of the kernel behind `fmumaker`'s C layer."""

from __future__ import annotations

from bms_ukf.estimator_fmu.package import export

__all__ = ["export"]
