"""From a received frame to samples the estimator may take: checked, decoded, in the order of time."""

from __future__ import annotations

from collections.abc import Sequence

from bms_ukf.alignment import Alignment
from bms_ukf.decoder import Decoder
from bms_ukf.frames import Counters
from bms_ukf.open_circuit import OpenCircuit
from bms_ukf.records import Sample


class Intake:
    """The way in, the same for the bus and for a log of it."""

    def __init__(
        self, decoder: Decoder, circuit: OpenCircuit | None = None, alignment: Alignment | None = None
    ) -> None:
        """None: there is no contactor signal; every signal arrives as late as the others."""
        self.decoder, self._circuit = decoder, circuit
        self._alignment = alignment or Alignment()

    @property
    def counters(self) -> Counters:
        """What became of the received frames."""
        return self.decoder.counters

    @property
    def contradictions(self) -> int:
        """How often a current was shown while the contactors were open."""
        return 0 if self._circuit is None else self._circuit.contradictions

    @property
    def behind_ns(self) -> int:
        """How much older than the frame a sample may be that comes of it."""
        return self._alignment.behind_ns

    def take(
        self, arbitration_id: int, is_extended_id: bool, data: bytes, t_ns: int, *, classic: bool = True
    ) -> Sequence[Sample]:
        """The samples that are due with a frame received at `t_ns`, none if it was refused; see `Inbox.decode`."""
        sample = self.decoder.decode(arbitration_id, is_extended_id, data, t_ns, classic=classic)
        if sample is None:
            return ()
        if self._circuit is not None:
            contactor = self.decoder.contactor
            shown_A = sample.currents_A
            sample.open_circuit = self._circuit.nothing_flows(shown_A, t_ns, contactor.is_open, contactor.t_ns)
        return self._bled(self._alignment.put(sample), t_ns)

    def due(self, t_ns: int) -> Sequence[Sample]:
        """The samples that are due at `t_ns` though no frame came."""
        return self._bled(self._alignment.due(t_ns), t_ns)

    def _bled(self, samples: Sequence[Sample], t_ns: int) -> Sequence[Sample]:
        """Samples that leave at `t_ns`, with what was heard of balancing up to then, however late they are."""
        balancing = self.decoder.balancing
        if balancing is not None:
            for sample in samples:
                sample.bleed_A = balancing.at(t_ns)
        return samples
