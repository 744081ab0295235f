"""What is known of a pack, and of each of its cells, to frames of the project's own DBC."""

from __future__ import annotations

from bms_ukf.dbc import Field, Insert, own_matrix
from bms_ukf.frames import Frame, Outbox, Pages
from bms_ukf.pack import PackEstimate
from bms_ukf.records import NAN, Estimate, Status

SELDOM_NS = 1_000_000_000

# The signals of each message, with what they say of a PackEstimate and by how much a bit's worth is divided.
OFTEN = {
    "PackPowers": {"DischargePower": ("discharge_W", 1.0), "ChargePower": ("charge_W", 1.0)},
    "PackCurrents": {
        "DischargeCurrent": ("discharge_A", 1.0),
        "ChargeCurrent": ("charge_A", 1.0),
        "DischargeCell": ("discharge_cell", 1.0),
        "ChargeCell": ("charge_cell", 1.0),
    },
    "PackState": {
        "UsableSoc": ("soc", 0.01),
        "UsableSocSigma": ("soc_sigma", 0.01),
        "SocSpread": ("soc_spread", 0.01),
        "RemainingCharge": ("remaining_Ah", 1.0),
    },
}
SELDOM = {
    "PackEnergy": {"RemainingEnergy": ("remaining_Wh", 1.0), "ChargeableEnergy": ("chargeable_Wh", 1.0)},
    "PackTimes": {
        "TimeToEmpty": ("time_to_empty_s", 1.0),
        "TimeToFull": ("time_to_full_s", 1.0),
        "SilentCells": ("silent", 1.0),
        "FirstSilentCell": ("silent_cell", 1.0),
    },
}
# The paged messages, with the fields of an Estimate that they have of every cell.
OF_CELLS = {"CellSoc": "soc", "CellSigma": "soc_sigma", "CellLow": "soc_low", "CellHigh": "soc_high"}
# From 0 inside, from 1 on the bus.
CELL_NUMBERS = {"discharge_cell", "charge_cell", "silent_cell", "capacity_cell", "resistance_cell", "cell"}


class PackEncoder:
    """Turns what is known of a pack into frames; the alive counters are as those of `encoder.Encoder`.

    PackState, PackCurrents and PackPowers go with every set, PackEnergy and PackTimes once a second, StringBias with
    them if there are several strings. Of several cells the pages of CellSoc, CellSigma, CellLow and CellHigh follow
    each other so that all are sent within a period.
    """

    def __init__(self, cells: int, cell_soc_period_s: float, strings: int = 1) -> None:
        matrix = own_matrix()
        self._often = [Told(name, signals) for name, signals in OFTEN.items()]
        self._seldom = [Told(name, signals) for name, signals in SELDOM.items()]
        self._seldom_ns: int | None = None
        self._bias = Pages(matrix, "StringBias", "String", strings) if strings > 1 else None
        self._biases_told = self._bias_accepted = 0
        self._of_cells = [(field, Pages(matrix, name, "Cell", cells, 0.01)) for name, field in OF_CELLS.items()]
        self._pages = self._of_cells[0][1].count
        self._apart_ns = int(1e9 * cell_soc_period_s / self._pages) if cells > 1 else None
        self._page_ns: int | None = None  # when the next page is due
        self._page = self._pages_told = self._accepted = 0

    def encode(self, t_ns: int, estimate: Estimate, pack: PackEstimate, accepted: int) -> list[Frame]:
        """What is due with a set that is sent at `t_ns`."""
        frames = self._cells(t_ns, estimate, accepted)
        if self._seldom_ns is None or t_ns - self._seldom_ns >= SELDOM_NS:
            frames += [message.frame(pack, accepted) for message in self._seldom]
            frames += self._biases(pack, accepted)
            self._seldom_ns = t_ns
        return frames + [message.frame(pack, accepted) for message in self._often]

    def _biases(self, pack: PackEstimate, accepted: int) -> list[Frame]:
        pages = self._bias
        if pages is None:
            return []
        moves = accepted != self._bias_accepted  # as for the cells
        self._bias_accepted = accepted
        frames = []
        for page in range(pages.count):
            self._biases_told += moves
            frames.append(pages.frame(page, pack.current_bias_A, self._biases_told))
        return frames

    def _cells(self, t_ns: int, estimate: Estimate, accepted: int) -> list[Frame]:
        if self._apart_ns is None:
            return []
        if self._page_ns is None:
            self._page_ns = t_ns
        self._page_ns = max(self._page_ns, t_ns - (self._pages - 1) * self._apart_ns)  # after a silence, no page twice
        known = estimate.status in {Status.OK, Status.DEGRADED}
        moves = accepted != self._accepted  # a counter that stands still would have all pages but one refused
        self._accepted = accepted
        frames = []
        while self._page_ns <= t_ns:
            self._pages_told += moves
            for field, pages in self._of_cells:
                frames.append(pages.frame(self._page, getattr(estimate, field) if known else NAN, self._pages_told))
            self._page = (self._page + 1) % self._pages
            self._page_ns += self._apart_ns
        return frames


class Told:
    """One message, its signals bound to the fields of what it tells of."""

    def __init__(self, name: str, signals: dict[str, tuple[str, float]]) -> None:
        matrix = own_matrix()
        self._box = Outbox(matrix.message(name))
        self._inserts: list[tuple[str, Insert]] = [
            (field, Field(*matrix.find(f"{name}.{signal}")).insert(factor))
            for signal, (field, factor) in signals.items()
        ]

    def frame(self, told: object, accepted: int) -> Frame:
        word = 0
        for field, insert in self._inserts:
            value = getattr(told, field)
            if field in CELL_NUMBERS:
                value = NAN if value < 0 else value + 1.0
            word |= insert(value)
        return self._box.frame(word, accepted)
