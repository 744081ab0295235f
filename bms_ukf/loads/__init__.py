"""What a plant is asked to deliver: drive cycles, recordings, constants, rests, CC-CV charges, schedules of them.

    [load]
    repeat = 3                                          # the whole list, over and over
    segments = [
        { rest_s = 600 },
        { cycle = "wltc_3b", repeat = 4 },              # shipped speed trace, or a CSV with time_s,speed_mps
        { current_A = -2.5, duration_s = 1800 },        # constant cell current, positive = discharge
        { csv = "measured.csv", current_positive = "charge" },   # time_s,current_A
        { schedule = [{ cycle = "udds" }, { rest_s = 600 }], repeat = 50, until_below_V = 3.0 },
        { cccv_A = -2.5, voltage_V = 4.2, cutoff_A = 0.25 },     # charge
    ]

    [load.vehicle]                                      # optional: any field of Vehicle
    mass_kg = 1400

`models/loads/README.md` has all of it.
"""

from bms_ukf.loads.demand import Demand
from bms_ukf.loads.load import Load
from bms_ukf.loads.profile import Profile
from bms_ukf.loads.series import read_series
from bms_ukf.loads.vehicle import Vehicle

__all__ = ["Demand", "Load", "Profile", "Vehicle", "read_series"]
