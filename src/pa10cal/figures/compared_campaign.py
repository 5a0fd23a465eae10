"""What of a campaign stands beside the values of the paper."""

from __future__ import annotations

from dataclasses import dataclass

from pa10cal.figures import published
from pa10cal.figures.repeats import Scatter, scatter_by_load
from pa10cal.figures.results import Results
from pa10cal.results.accuracy import Accuracy
from pa10cal.results.calibration import PaperCalibrationRecord
from pa10cal.results.evaluation import HoldoutRecord
from pa10cal.results.montecarlo import PlaneRecord


@dataclass(frozen=True)
class Found:
    """What our side of the comparison is taken from."""

    combined: PaperCalibrationRecord  # calibration of all loads together
    evaluated: PaperCalibrationRecord  # calibration that was evaluated on held-out points
    cases: dict[str, PaperCalibrationRecord]  # calibration of each load, by load as `0N`, `22N`, …
    held_out: HoldoutRecord  # evaluation on held-out points
    scatter: dict[str, Scatter]  # of repeats, by load
    planes: dict[int, PlaneRecord]  # Monte Carlo by height [mm]
    instrument_uncertainty_mm: float  # as the campaign states it
    kcub_reading: str  # which of the paper's cubic stiffnesses stands beside ours

    @classmethod
    def of(cls, results: Results) -> Found:
        """Read everything that the comparison needs."""
        held_out = results.held_out()
        return cls(
            combined=results.calibration(),
            evaluated=results.calibration(held_out.calibration),
            cases=results.load_cases(),
            held_out=held_out,
            scatter=scatter_by_load(results.places()),
            planes={plane.plane_mm: plane for plane in results.planes()},
            instrument_uncertainty_mm=results.instrument_uncertainty_mm,
            kcub_reading=results.settings.kcub_reading,
        )

    def before(self, load: str) -> Accuracy | None:
        """Return the errors of the nominal model at a load, None where it was not measured."""
        errors = self.combined.errors.get(load)
        return None if errors is None else errors.before

    def after(self, load: str) -> Accuracy | None:
        """Return the errors at a load of the calibration at this load alone."""
        case = self.cases.get(load)
        return None if case is None else case.errors[load].after

    def after_combined(self, load: str) -> Accuracy | None:
        """Return the errors at a load of the calibration of all loads together."""
        errors = self.combined.errors.get(load)
        return None if errors is None else errors.after

    @property
    def loads(self) -> list[str]:
        """Return the loads of the paper, then those that the campaign alone has."""
        stated = list(published.BEFORE)
        return stated + [load for load in self.cases if load not in stated]

    @property
    def paper_plane(self) -> PlaneRecord | None:
        """The plane for which the paper states its Monte Carlo result, None where not run."""
        return self.planes.get(published.MONTE_CARLO_PLANE_MM)
