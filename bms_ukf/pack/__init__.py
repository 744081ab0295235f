"""What a vehicle wants to know of a battery of many cells: how far it reaches, what it may give, how it ages."""

from bms_ukf.pack.health import Health
from bms_ukf.pack.limits import Limits
from bms_ukf.pack.pack import Pack
from bms_ukf.pack.record import Ageing, PackEstimate

__all__ = ["Ageing", "Health", "Limits", "Pack", "PackEstimate"]
