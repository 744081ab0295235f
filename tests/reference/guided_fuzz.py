"""The way of a frame through the daemon against a second one made of other people's parts: `python -m guided_fuzz`.

An input is read as events: frames as they are, frames protected as they should be whatever they say, silence. What the
daemon's core makes of them is compared, step by step, with autosar-e2e's check, cantools' decoding and an estimator
that is given those samples and nothing else; so no frame that should be refused moves the SoC, and none that is
published as valid is another one. atheris looks for inputs that reach new code (arguments are libFuzzer's).
"""

from __future__ import annotations

import math
import sys
import time
from collections import deque

from cantools.database.errors import DecodeError
from e2e.p11 import e2e_p11_check, e2e_p11_protect

from bms_ukf import CellParams, Estimate, Estimator, Sample, Status

IDS = {0x120: 0xB501, 0x121: 0xB502, 0x122: 0xB503}  # and their data ids
TIMEOUT_NS = {0x120: 500_000_000, 0x121: 500_000_000, 0x122: 5_000_000_000}
SIGNALS = {
    0x120: ("PackCurrent", "current_A"),
    0x121: ("Cell1", "voltage_V"),
    0x122: ("Sensor1", "temperature_degC"),
}
OTHER_IDS = (0x123, 0x220, 0x7FF, 0x000)
MODULO, MAX_DELTA = 15, 7  # of the alive counter
VALID = (Status.OK, Status.DEGRADED)
MS = 1_000_000


class Judge:
    """The second way in: which frames are to be accepted, and what they say. Also the core's witness."""

    def __init__(self, cell: CellParams) -> None:
        from bms_ukf.dbc import own_matrix

        matrix = own_matrix()
        self._messages = {
            i: matrix.message(n)
            for i, n in zip(IDS, ("PackMeasurement", "CellVoltages", "CellTemperatures"), strict=True)
        }
        self._published = matrix.message("SocEstimate")
        self._last: dict[int, tuple[int, int]] = {}  # alive counter and time of the last accepted frame
        self._expected: deque[Sample] = deque()
        self.alone = Estimator(cell)
        self.told = Estimate()
        self.refused = self.steps = 0

    def next_counter(self, number: int, ahead: int) -> int:
        return (self._last.get(number, (MODULO - 1, 0))[0] + 1 + ahead) % MODULO

    def hears(self, number: int, wide: bool, data: bytes, t_ns: int, classic: bool) -> None:
        """Take note of a frame before the core has it."""
        if wide or not classic or number not in IDS:
            return
        if not self._accepts(number, data[:8], t_ns):
            self.refused += 1
            return
        try:
            signals = self._messages[number].decode(data[:8])
        except DecodeError:  # a page that no DBC has
            return
        name, field = SIGNALS[number]
        if name in signals:
            value = signals[name]  # a word: not available, or an error
            sample = Sample(t_ns)
            setattr(sample, field, float(value) if isinstance(value, int | float) else math.nan)
            self._expected.append(sample)

    def _accepts(self, number: int, data: bytes, t_ns: int) -> bool:
        if len(data) < 8 or not e2e_p11_check(bytearray(data), IDS[number]):
            return False
        counter = data[1] & 0x0F
        if counter >= MODULO:
            return False
        if number in self._last:
            last, last_ns = self._last[number]
            ahead = (counter - last) % MODULO
            if ahead == 0 or (ahead > MAX_DELTA and t_ns - last_ns <= TIMEOUT_NS[number]):
                return False
        self._last[number] = counter, t_ns
        return True

    def stepped(self, sample: Sample, estimate: Estimate) -> None:
        known = self._expected.popleft()
        for ours, theirs in (
            (sample.current_A, known.current_A),
            (sample.voltage_V, known.voltage_V),
            (sample.temperature_degC, known.temperature_degC),
        ):
            assert math.isclose(ours, theirs, abs_tol=1e-9) or (math.isnan(ours) and math.isnan(theirs)), (
                sample,
                known,
            )
        assert sample.t_ns == known.t_ns
        self.told = self.alone.step(sample, out=self.told)
        self._compare(estimate)

    def coasted(self, t_ns: int, estimate: Estimate) -> None:
        if self._expected:
            empty = self._expected.popleft()
            assert all(map(math.isnan, (empty.current_A, empty.voltage_V, empty.temperature_degC))), empty
        self.told = self.alone.coast(t_ns, out=self.told)
        self._compare(estimate)

    def published(self, *_: object) -> None:
        """Judged as a frame."""

    def _compare(self, estimate: Estimate) -> None:
        self.steps += 1
        for ours, theirs in ((estimate.soc, self.told.soc), (estimate.soc_sigma, self.told.soc_sigma)):
            assert ours == theirs or (math.isnan(ours) and math.isnan(theirs)), (estimate, self.told)
        assert estimate.status is self.told.status

    def reads(self, data: bytes) -> None:
        """The SocEstimate that was published."""
        assert e2e_p11_check(bytearray(data), 0xB511)
        said = self._published.decode(data)
        available = self.told.status in VALID
        assert (int(said["Status"]) if isinstance(said["Status"], int) else said["Status"].value) in (
            (1, 2) if available else (int(self.told.status),)
        ), said
        for name, known in (("Soc", self.told.soc), ("SocSigma", self.told.soc_sigma)):
            if available:
                assert abs(float(said[name]) - 100 * min(known, 1.0)) <= 0.00126, (name, said, self.told)
            else:
                assert said[name] == "NotAvailable", (name, said)

    def is_done(self) -> None:
        assert not self._expected, "a frame that is right was not used"


class Target:
    """The core, with the judge as its witness and its listener; called with one input after the other."""

    def __init__(self) -> None:
        from bms_ukf.core import Core
        from bms_ukf.decoder import Decoder
        from bms_ukf.encoder import Encoder
        from bms_ukf.intake import Intake
        from bms_ukf.pace import Pace
        from bms_ukf.records import Detail

        cell = CellParams.load("lgm50_chen2020")
        judge, encoder = Judge(cell), Encoder()

        class Heard(Core):
            def _send(self, t_ns: int, detail: Detail) -> None:
                judge.reads(encoder.encode(self.estimate, detail, self.estimator.accepted)[-1][2])

        self.judge, self._decoder, self._estimator = judge, Decoder(), Estimator(cell)
        self._make = lambda: Heard(self._estimator, Intake(self._decoder), Pace())
        for k in range(60):
            self._estimator.step(Sample(k * 100 * MS, 1.0, 3.9, 25.0))
        self._settled = self._estimator.snapshot()
        self._t_ns = 6_000 * MS
        self.frames = 0

    def __call__(self, data: bytes) -> None:
        """One input, from a battery that is not known, or one that is."""
        estimator, alone = self._estimator, self.judge.alone
        for one in (estimator, alone):
            one.reset()
            if data[:1] > b"\x7f":
                one.restore(self._settled)
            one.t_ns = self._t_ns  # time goes on, as the counters of the frames do
        core = self._make()
        core.estimate = estimator.coast(self._t_ns, out=core.estimate)
        self.judge.told = alone.coast(self._t_ns)
        core.witness = self.judge
        at = 1
        while at < len(data):
            at = self._event(core, data, at)
        self.judge.is_done()
        counters = self._decoder.counters
        counted = counters.accepted + counters.unknown_id + counters.not_data + counters.refused
        assert counted == self.frames, counters
        assert counters.refused == self.judge.refused, counters

    def _event(self, core: object, data: bytes, at: int) -> int:
        kind, at = data[at], at + 1
        if kind & 7 == 0:  # silence
            self._t_ns += int.from_bytes(data[at : at + 2], "big") * MS
            core.idle(self._t_ns)  # type: ignore[attr-defined]
            return at + 2
        choice = kind >> 3 & 7
        number = (*IDS, *OTHER_IDS, 0x121)[choice]
        payload, at = bytearray(data[at : at + 8]), at + 8
        if kind & 7 < 5 and number in IDS and len(payload) == 8:
            if kind & 4 == 0:
                payload[1] = payload[1] & 0xF0 | self.judge.next_counter(number, kind & 1)
            e2e_p11_protect(payload, IDS[number], increment_counter=False)
        self._t_ns += (kind >> 6) * 30 * MS
        wide, classic = kind & 7 == 6, kind & 0xC7 != 0xC7
        self.frames += 1
        self.judge.hears(number, wide, bytes(payload), self._t_ns, classic)
        core.hear(number, wide, bytes(payload), self._t_ns, classic=classic)  # type: ignore[attr-defined]
        return at


def main() -> None:
    import atheris

    with atheris.instrument_imports(include=["bms_ukf"]):  # the kernel, which numba compiles, is imported above
        target = Target()
    began_s, runs = time.monotonic(), 0

    def one_input(data: bytes) -> None:
        nonlocal runs
        runs += 1
        target(data)
        if runs % 100_000 == 0:
            judge, took_s = target.judge, time.monotonic() - began_s
            done = f"{target.frames} frames, {judge.refused} refused, {judge.steps} steps compared"
            print(f"{runs} inputs, {done}, {took_s:.0f} s", flush=True)  # noqa: T201

    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
