"""Battery state-of-charge estimation for a CAN bus: a square-root unscented Kalman filter with an honest error bar."""

from bms_ukf.cell import CellParams
from bms_ukf.errors import BmsError, ConfigError, PlantError
from bms_ukf.estimator import Estimator
from bms_ukf.records import Estimate, Fault, Sample, Status
from bms_ukf.tuning import Tuning

__version__ = "0.1.0"
__all__ = [
    "BmsError",
    "CellParams",
    "ConfigError",
    "Estimate",
    "Estimator",
    "Fault",
    "PlantError",
    "Sample",
    "Status",
    "Tuning",
]
