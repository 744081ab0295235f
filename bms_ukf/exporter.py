"""What a monitoring system may ask of the daemon: Prometheus metrics over HTTP, on this machine only."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bms_ukf.daemon import Daemon
from bms_ukf.errors import ConfigError
from bms_ukf.pack import Ageing
from bms_ukf.records import Fault, Status, largest_known, mean_known, smallest_known

if TYPE_CHECKING:
    from prometheus_client.core import Metric

ADDRESS = "127.0.0.1"


class Exporter:
    """Answers http://127.0.0.1:PORT/metrics from a thread of its own, by what the daemon says when it is asked."""

    def __init__(self, daemon: Daemon, port: int, source: str) -> None:
        """ConfigError, naming the configuration `source`, if the port is taken or the client library missing."""
        try:
            from prometheus_client import CollectorRegistry, start_http_server
        except ImportError:
            expected = "the package prometheus-client (pip install 'bms-ukf[metrics]')"
            raise ConfigError(source, key="metrics", expected=expected) from None
        self._daemon = daemon
        registry = CollectorRegistry()
        registry.register(self)
        try:
            self._server, self._thread = start_http_server(port, ADDRESS, registry)
        except OSError as error:
            expected = f"a port of this machine that is free ({error.strerror})"
            raise ConfigError(source, key="metrics.port", value=port, expected=expected) from None

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def collect(self) -> Iterator[Metric]:
        """Everything at once; what is not available is NaN."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        daemon, estimate = self._daemon, self._daemon.estimate
        for name, text, value in (
            ("soc_ratio", "State of charge, mean of the cells", mean_known(estimate.soc)),
            (
                "soc_sigma_ratio",
                "A 3.92th of its 95 % interval, the largest of the cells",
                largest_known(estimate.soc_sigma),
            ),
            ("soc_low_ratio", "Lower bound of its 95 % interval, smallest of cells", smallest_known(estimate.soc_low)),
            ("soc_high_ratio", "Upper bound, the largest of the cells", largest_known(estimate.soc_high)),
            ("information_age_seconds", "Since a voltage was last used", largest_known(estimate.age_s)),
            ("current_bias_amperes", "What the current sensor shows too much", daemon.current_bias_A()),
        ):
            yield GaugeMetricFamily(f"bms_ukf_{name}", text, value)
        if daemon.health is not None:
            yield from self._aged(daemon.health.ageing())
        status = GaugeMetricFamily("bms_ukf_status", "1 for the present one", labels=["status"])
        for word in Status:
            status.add_metric([word.word], float(estimate.status is word))
        yield status
        fault = GaugeMetricFamily("bms_ukf_fault", "1 while it is there", labels=["fault"])
        for bit in Fault:
            fault.add_metric([str(bit.name).lower()], float(bool(estimate.faults & bit)))
        yield fault
        received, bus = daemon.intake.counters, daemon.bus.counters
        frames = CounterMetricFamily("bms_ukf_received_frames", "What became of them", labels=["outcome"])
        for outcome in ("accepted", "not_data", "short", "crc", "counter", "lost"):
            frames.add_metric([outcome], getattr(received, outcome))
        yield frames
        events = CounterMetricFamily("bms_ukf_bus_events", "What went wrong on the bus", labels=["event"])
        for event in ("send_failed", "receive_failed", "reopened", "bus_off", "dropped"):
            events.add_metric([event], getattr(bus, event))
        yield events
        yield CounterMetricFamily("bms_ukf_answers", "Sets of frames sent", daemon.published)
        yield CounterMetricFamily("bms_ukf_samples_accepted", "By the estimator", daemon.estimator.accepted)

    def _aged(self, told: Ageing) -> Iterator[Metric]:
        from prometheus_client.core import GaugeMetricFamily

        for name, text, told_as in (
            ("capacity_ratio", "Capacity over the cell file's, of the cell with least", "capacity_min"),
            ("capacity_mean_ratio", "The same, mean of the cells", "capacity_mean"),
            ("capacity_sigma_ratio", "Standard deviation of the least", "capacity_sigma"),
            ("capacity_segments", "Changes of SoC between rests that have told of it", "segments"),
            ("resistance_ratio", "r0 over the cell file's, of the cell with most", "resistance_max"),
            ("resistance_mean_ratio", "The same, mean of the cells", "resistance_mean"),
            ("resistance_sigma_ratio", "Standard deviation of the most", "resistance_sigma"),
        ):
            yield GaugeMetricFamily(f"bms_ukf_{name}", text, getattr(told, told_as))
