"""The virtual cell: writes raw campaigns; shares no formula with the estimator."""
