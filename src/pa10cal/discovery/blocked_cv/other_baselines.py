"""Other models from which the search of a survey may set out, where its own lacks parameters.

A calibration has no effects, and explains what they do by the parameters that it has: it leaves
tilts of parallel axes at zero where an effect hides them, and gives joints the deflections of
links, bearings and base. Once effects are found, the search can begin again about a better model.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeGuard

import numpy as np

from pa10cal.arrays import Array
from pa10cal.calibration.general.calibrate import shown
from pa10cal.discovery.blocked_cv.refit import Refit, refit
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.model_with_effects import identified_geometry
from pa10cal.discovery.pose_scatter import PoseWeights
from pa10cal.discovery.preparation import Prepared
from pa10cal.discovery.together import ScoredSet, Together
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.options import Tolerances
from pa10cal.terms.joint_spring import is_spring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import Offsets, link_departures
from pa10cal.terms.term import Term
from pa10cal.terms.weights import holds_weights


def survey_about(campaign: Prepared, model: FittedModel, weights: PoseWeights) -> Survey:
    """Return a survey whose search sets out from another model, fitted to the survey's poses.

    Args:
        campaign: the campaign of the survey.
        model: the other model; its values are the start of the fit.
        weights: of the poses, at the start of the fit.
    """
    fitted = refit(Survey.of(campaign, model), (), (), weights).fitted()
    return replace(Survey.of(campaign, fitted), calibrated_before=campaign.baseline)


def with_tilts_shown(survey: Survey, found: Refit) -> FittedModel | None:
    """Return the survey's baseline with tilts of parallel axes, if a fit with effects shows them.

    None where they are not shown, or the tilts are not just what the baseline lacks of the link
    parameters that the instrument can identify.
    """
    baseline, measured = survey.baseline, survey.poses.measured
    links = next((term for term in baseline.model.terms if _is_of_links(term)), None)
    if links is None:
        return None
    identified = identified_geometry(baseline, measured).links
    role_of = dict(
        zip((each.name for each in identified.parameters), identified.roles, strict=True)
    )
    tilts = {name for name, role in role_of.items() if role == "tilt"}
    if not tilts or role_of.keys() - {each.name for each in links.parameters} != tilts:
        return None
    tilted = _with_link_parameters(baseline, links, identified.only(tilts))
    starts = tuple(map(found.at.values_of, found.effects))
    fitted = refit(replace(survey, baseline=tilted), found.effects, starts, found.weights)
    at = [k for k, each in enumerate(tilted.model.parameters) if each.name in tilts]
    covariance = fitted.covariance[np.ix_(at, at)]
    readings = int(measured.components_seen.sum())
    return tilted if shown(fitted.x[at], covariance, readings) else None


def _is_of_links(term: Term) -> TypeGuard[Offsets]:
    return term.of == "links" and term.constant


def _with_link_parameters(baseline: FittedModel, links: Offsets, added: Offsets) -> FittedModel:
    """Return a model whose links have further parameters, at zero, in the usual order.

    Parameters that its links have stay, also those that this instrument does not identify.
    """
    order = link_departures(baseline.arm, Tolerances()).coordinates
    own = zip(links.coordinates, links.parameters, baseline.values_of(links), strict=True)
    new = zip(added.coordinates, added.parameters, np.zeros(len(added.parameters)), strict=True)
    coordinates, parameters, values = zip(
        *sorted((*own, *new), key=lambda each: order.index(each[0])), strict=True
    )
    wider = replace(links, coordinates=coordinates, parameters=parameters)
    terms = tuple(wider if term is links else term for term in baseline.model.terms)
    x = [values if term is links else baseline.values_of(term) for term in baseline.model.terms]
    model = Model(baseline.model.chain, terms)
    return replace(baseline, model=model, x=np.concatenate(x), covariance=None)


def without_spring(calibrated: FittedModel, spring: Term) -> FittedModel:
    """Return a calibrated model with a joint rigid that has a spring in it."""
    terms = tuple(term for term in calibrated.model.terms if term is not spring)
    x = np.concatenate([calibrated.values_of(term) for term in terms])
    return replace(calibrated, model=Model(calibrated.model.chain, terms), x=x, covariance=None)


def with_compliances_of(
    calibrated: FittedModel, sets: Together, likeliest: ScoredSet
) -> FittedModel:
    """Return a calibrated model with the springs and weights of a set in place of its own.

    The set is one of what gives way under weights that nobody stated. Its effects are not in the
    model, but its links are divided where these bend them.
    """
    springs = sets.springs(likeliest)
    terms = [term for term in calibrated.model.terms if not is_spring(term)]
    # springs stand after the links, else first
    first = 1 + next((k for k, term in enumerate(terms) if term.of == "links"), -1)
    terms[first:first] = springs
    weights = sets.weights_of(likeliest)

    def start(term: Term) -> Array:
        if term in springs:
            return springs[term]
        if holds_weights(term):  # the set was found about weights of its own
            return weights[list(term.columns)]
        return calibrated.values_of(term)

    bent = calibrated.bending_as(sets.effects(likeliest))
    model = Model(bent.model.chain, tuple(terms))
    return replace(bent, model=model, x=np.concatenate([*map(start, terms)]), covariance=None)
