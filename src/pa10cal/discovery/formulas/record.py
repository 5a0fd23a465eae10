"""A proposed formula as a part of the verdict's record."""

from __future__ import annotations

import numpy as np

from pa10cal.discovery.formulas.choose import Proposal
from pa10cal.results.accuracy import EffectParameter
from pa10cal.results.effect_name import EffectName
from pa10cal.results.proposed import ProposedEvidence, ProposedFormula


def proposed_formula(found: Proposal) -> ProposedFormula:
    """Return a proposal as `verdict.json` holds it."""
    without, held, with_it = found.squares
    form = found.form
    known = form.report(np.zeros(len(form.parameters))).parameters
    std = np.sqrt(np.diag(found.covariance))
    return ProposedFormula(
        formula=form.formula,
        of=form.of,
        form=form.form,
        numbers=form.numbers,
        orders=found.orders,
        parameters={
            parameter.name: EffectParameter(value=value, std=sigma, unit=parameter.unit)
            for parameter, value, sigma in zip(known, found.x.tolist(), std.tolist(), strict=True)
        },
        gain=found.gain,
        does_as_well_as=tuple(EffectName(id=each.id, of=each.of) for each in found.instead),
        others=tuple(other.formula for other in found.others),
        evidence=ProposedEvidence(
            blocks=found.blocks,
            rows=found.rows,
            squared_error_without=without,
            squared_error_with=with_it,
            squared_error_held=held,
            gain_std=found.gain_std,
        ),
    )
