"""What the base traces of a plant are: loads scaled to its cell, at several temperatures, new and aged.

A base trace is long and open-loop: the campaign cuts it anywhere, and puts sensor errors, gaps and faults in itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from bms_ukf.campaign.plants import CampaignPlant

HOUR_S = 3600.0
AGED_CAPACITY, AGED_RESISTANCE = 0.9, 1.5  # of a new cell's
EMPTY_SOC = 0.05

Segments = list[dict[str, Any]]


class Recipe(NamedTuple):
    """One base trace: a `[load]` table, where the plant starts, and what the cells are."""

    name: str
    kind: str
    ambient_degC: float
    soc_initial: float
    load: dict[str, Any]
    step_s: float = 1.0
    aged: bool = False
    cells: int = 1


def of(plant: CampaignPlant) -> list[Recipe]:
    """All recipes of a plant: those of every plant, and for the shipped one the cold, the fast and the large pack."""
    recipes = [
        _drive(plant, 25.0, 0.92),
        _drive(plant, 0.0, 0.85),
        _drive(plant, 10.0, 0.9),
        _drive(plant, 45.0, 0.95),
        _drive(plant, 25.0, 0.85, aged=True),
        _constant(plant, 25.0),
        _charge(plant, 25.0),
        _charge(plant, 10.0),
        _mixed(plant, 25.0),
        _long_rest(plant, 0.0, 0.35),
        _long_rest(plant, 40.0, 0.75),
        _pack(plant, 4, 25.0, 0.9),
    ]
    if plant.maker:
        return recipes
    return [
        *recipes,
        _drive(plant, -20.0, 0.85),
        _drive(plant, -10.0, 0.8),
        _drive(plant, 0.0, 0.75, aged=True),
        _constant(plant, 0.0),
        _charge(plant, 40.0),
        _charge(plant, 25.0, aged=True),
        _mixed(plant, 10.0),
        _long_rest(plant, -10.0, 0.3),
        _long_rest(plant, 25.0, 0.55),
        _fast(plant),
        _pack(plant, 4, 0.0, 0.7),
        _pack(plant, 96, 25.0, 0.7),
    ]


def vehicle(plant: CampaignPlant, ambient_degC: float) -> dict[str, Any]:
    """A car that takes some 3 C of its cells at most; in the cold, where they cannot give that, a lighter one."""
    share = 1.0 if ambient_degC >= 10 else 0.65 if ambient_degC >= -5 else 0.45 if ambient_degC >= -15 else 0.3
    parallel = 18 * 5.0 * 3.63 / (plant.nominal_Ah * plant.nominal_V)
    return {"cells_parallel": max(round(parallel / share), 1), "cell_voltage_nominal_V": plant.nominal_V}


def _limited(plant: CampaignPlant, soc: float = EMPTY_SOC) -> dict[str, float]:
    return {"until_below_soc": soc, "until_below_V": plant.low_V + 0.05}


def _name(what: str, ambient_degC: float, aged: bool = False) -> str:
    return f"{what}_{'n' if ambient_degC < 0 else ''}{abs(ambient_degC):g}degC{'_aged' if aged else ''}"


def _cycles(plant: CampaignPlant, *pairs: tuple[str, float]) -> Segments:
    """Drive cycles with a rest after each, s; a cycle ends early where the voltage is low."""
    low = {"until_below_V": plant.low_V + 0.05}
    return [segment for cycle, rest_s in pairs for segment in ({"cycle": cycle} | low, {"rest_s": rest_s})]


def _drive(plant: CampaignPlant, ambient_degC: float, soc: float, aged: bool = False) -> Recipe:
    round_ = _cycles(plant, ("udds", 600.0), ("us06", 300.0), ("hwfet", 1200.0), ("wltc_3b", 1800.0))
    segments: Segments = [
        {"rest_s": (2.0 if ambient_degC >= 10 else 3.0) * HOUR_S},
        {"schedule": round_, "repeat": 4} | _limited(plant),
        {"rest_s": HOUR_S / 2},
    ]
    load = {"segments": segments, "vehicle": vehicle(plant, ambient_degC)}
    return Recipe(_name("drive", ambient_degC, aged), "rest_then_drive", ambient_degC, soc, load, aged=aged)


def _constant(plant: CampaignPlant, ambient_degC: float) -> Recipe:
    C = plant.nominal_Ah
    strong = 1.0 if ambient_degC >= 10 else 0.5
    round_: Segments = [
        {"current_A": C / 3, "duration_s": 1800.0} | _limited(plant),
        {"rest_s": 1500.0},
        {"current_A": strong * C, "duration_s": 720.0} | _limited(plant),
        {"rest_s": 2700.0},
        {"current_A": 0.1 * C, "duration_s": 1200.0} | _limited(plant),
    ]
    segments: Segments = [{"rest_s": HOUR_S}, {"schedule": round_, "repeat": 3} | _limited(plant), {"rest_s": HOUR_S}]
    return Recipe(_name("constant", ambient_degC), "constant", ambient_degC, 0.95, {"segments": segments})


def _charge(plant: CampaignPlant, ambient_degC: float, aged: bool = False) -> Recipe:
    C = plant.nominal_Ah
    rate = C / 2 if ambient_degC >= 20 else C / 4
    cccv = {"cccv_A": -rate, "voltage_V": plant.high_V, "cutoff_A": C / 20}
    segments: Segments = [
        {"rest_s": 2 * HOUR_S},
        {"current_A": -C / 3, "duration_s": 2 * HOUR_S, "until_above_V": plant.high_V - 0.05},  # no CV phase
        {"rest_s": HOUR_S},
        {"current_A": C / 2, "duration_s": 1.2 * HOUR_S} | _limited(plant, 0.2),
        {"rest_s": 1200.0},
        cccv,
        {"rest_s": HOUR_S},
        {"current_A": C, "duration_s": 0.7 * HOUR_S} | _limited(plant, 0.3),
        {"rest_s": 600.0},
        cccv | {"max_duration_s": 1500.0},  # interrupted, twice
        {"rest_s": 900.0},
        cccv | {"max_duration_s": 1200.0},
        {"current_A": C / 10, "duration_s": 300.0},
        cccv,
        {"rest_s": 2 * HOUR_S},
    ]
    return Recipe(_name("charge", ambient_degC, aged), "charge", ambient_degC, 0.12, {"segments": segments}, aged=aged)


def _mixed(plant: CampaignPlant, ambient_degC: float) -> Recipe:
    C = plant.nominal_Ah
    segments: Segments = [
        {"rest_s": HOUR_S},
        {"current_A": -C / 4, "duration_s": 2400.0},
        {"rest_s": 300.0},
        *_cycles(plant, ("wltc_3b", 900.0), ("us06", 600.0)),
        {"current_A": -C / 2, "duration_s": 1800.0, "until_above_V": plant.high_V},
        {"rest_s": 600.0},
        *_cycles(plant, ("hwfet", 60.0), ("udds", 1800.0)),
        {"current_A": -C / 3, "duration_s": 3000.0, "until_above_V": plant.high_V},
        *_cycles(plant, ("us06", HOUR_S)),
    ]
    load = {"segments": segments, "vehicle": vehicle(plant, ambient_degC)}
    return Recipe(_name("mixed", ambient_degC), "mixed", ambient_degC, 0.35, load)


def _long_rest(plant: CampaignPlant, ambient_degC: float, soc: float) -> Recipe:
    C = plant.nominal_Ah
    segments: Segments = [
        {"rest_s": 5 * HOUR_S},
        *_cycles(plant, ("us06", 6 * HOUR_S)),
        {"current_A": C / 4, "duration_s": 900.0} | _limited(plant),
        {"rest_s": 4 * HOUR_S},
    ]
    load = {"segments": segments, "vehicle": vehicle(plant, ambient_degC)}
    return Recipe(_name("long_rest", ambient_degC), "long_rest", ambient_degC, soc, load)


def _fast(plant: CampaignPlant) -> Recipe:
    segments: Segments = [{"rest_s": 120.0}, *_cycles(plant, ("us06", 120.0)), {"cycle": "us06"}, {"rest_s": 60.0}]
    load = {"segments": segments, "vehicle": vehicle(plant, 25.0)}
    return Recipe("fast_25degC", "rest_then_drive", 25.0, 0.7, load, step_s=0.1)


def _pack(plant: CampaignPlant, cells: int, ambient_degC: float, soc: float) -> Recipe:
    C = plant.nominal_Ah
    small: Segments = [
        {"rest_s": HOUR_S},
        *_cycles(plant, ("us06", 300.0), ("udds", 600.0)),
        {"current_A": -C / 4, "duration_s": 1200.0, "until_above_V": plant.high_V},
        {"rest_s": 600.0},
        *_cycles(plant, ("wltc_3b", 1200.0)),
    ]
    large: Segments = [{"rest_s": 900.0}, *_cycles(plant, ("us06", 300.0))]
    load = {"segments": large if cells > 10 else small, "vehicle": vehicle(plant, ambient_degC)}
    return Recipe(_name(f"pack{cells}", ambient_degC), "rest_then_drive", ambient_degC, soc, load, cells=cells)
