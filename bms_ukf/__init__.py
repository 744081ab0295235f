"""Battery state-of-charge estimation for a CAN bus: a square-root unscented Kalman filter with an honest error bar."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bms_ukf.cell import CellParams
    from bms_ukf.errors import BmsError, ConfigError, PlantError
    from bms_ukf.estimator import Estimator
    from bms_ukf.filter import Filter
    from bms_ukf.records import Estimate, Fault, Sample, Status
    from bms_ukf.sensor_spec import SensorSpec
    from bms_ukf.tuning import Tuning
    from bms_ukf.wiring import Wiring

__version__ = "0.1.0"
__all__ = [
    "BmsError",
    "CellParams",
    "ConfigError",
    "Estimate",
    "Estimator",
    "Fault",
    "Filter",
    "PlantError",
    "Sample",
    "SensorSpec",
    "Status",
    "Tuning",
    "Wiring",
]

# Imported when asked for: numba takes longer to load than `bms-ukf --help` should take.
_HOMES = {
    "BmsError": "errors",
    "CellParams": "cell",
    "ConfigError": "errors",
    "Estimate": "records",
    "Estimator": "estimator",
    "Fault": "records",
    "Filter": "filter",
    "PlantError": "errors",
    "Sample": "records",
    "SensorSpec": "sensor_spec",
    "Status": "records",
    "Tuning": "tuning",
    "Wiring": "wiring",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
