"""Time from a received frame to a sample, and from an estimate to its frames, protection included; `make bench`."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import count

import pytest

from bms_ukf import Estimate, Sample, Status
from bms_ukf.dbc import own_matrix
from bms_ukf.decoder import Decoder
from bms_ukf.encoder import Encoder
from bms_ukf.node import SampleEncoder
from bms_ukf.records import Detail

pytestmark = pytest.mark.bench

FRAMES, ROUNDS = 15 * 20, 500  # the alive counters must go round a whole number of times
SAMPLE = Sample(0, 1.5, 3.7, 25.0)
ESTIMATE = Estimate(0, 0.5, 0.01, 3.7, 0.001, 1e-6, 0.7, 0.1, Status.OK)


def quickest_us(work: Callable[[], object]) -> float:
    """Microseconds per frame of the least disturbed round."""
    best = float("inf")
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return best / FRAMES * 1e6


def test_codec_time_per_frame(capsys: pytest.CaptureFixture[str]) -> None:
    vehicle, decoder, encoder, steps = SampleEncoder(), Decoder(), Encoder(), count(1)
    current = [vehicle.pack(SAMPLE) for _ in range(FRAMES)]
    voltage = [vehicle.voltages(SAMPLE)[0] for _ in range(FRAMES)]
    pack = own_matrix().message("PackMeasurement")

    def decode(frames: list[tuple[int, bool, bytes]]) -> None:
        for arbitration_id, is_extended_id, data in frames:
            decoder.decode(arbitration_id, is_extended_id, data, 0)

    table = {
        "PackMeasurement to Sample": quickest_us(lambda: decode(current)),
        "CellVoltages to Sample": quickest_us(lambda: decode(voltage)),
        "Estimate to SocEstimate": quickest_us(lambda: [encoder.soc(ESTIMATE, next(steps)) for _ in range(FRAMES)]),
        "Estimate to a whole set": quickest_us(
            lambda: [encoder.encode(ESTIMATE, Detail(), next(steps)) for _ in range(FRAMES)]
        ),
        "cantools decode, no protection": quickest_us(lambda: [pack.decode(data) for _, _, data in current]),
    }
    assert decoder.counters.refused == decoder.counters.lost == 0
    with capsys.disabled():
        print("\n" + "\n".join(f"{name:32s}{us:8.2f} us" for name, us in table.items()))
