"""What the daemon publishes of a pack: follows the estimator, and makes the frames that go with a set."""

from __future__ import annotations

from bms_ukf.estimator import Estimator
from bms_ukf.frames import Frame
from bms_ukf.pack import Limits, Pack, PackEstimate
from bms_ukf.pack_encoder import PackEncoder
from bms_ukf.records import Estimate, Sample

CELL_SOC_PERIOD_S = 10.0


class PackOutput:
    """`estimate` is what is known of the pack, overwritten by the next set."""

    def __init__(
        self, estimator: Estimator, limits: Limits | None = None, cell_soc_period_s: float = CELL_SOC_PERIOD_S
    ) -> None:
        """Every cell's SoC is sent once in `cell_soc_period_s`."""
        self._pack = Pack(estimator, limits)
        self._encoder = PackEncoder(estimator.cells, cell_soc_period_s, estimator.wiring.strings)
        self.estimate = PackEstimate()

    def frames(self, whole: Sample, estimate: Estimate, accepted: int) -> list[Frame]:
        """Those to be sent before a set at the time of `whole`, all its measurements as one sample."""
        self.estimate = self._pack.update(estimate, whole)
        return self._encoder.encode(whole.t_ns, estimate, self.estimate, accepted)
