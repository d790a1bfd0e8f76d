"""Bodies: a fit of links and of a payload, drawn to the nearest ones that can exist.

The torque is linear in mass, first moments and inertia of a body, and a linear fit knows no bounds:
what little the motion shows of an inertia may come out as one that no body has. Of the bodies that
exist, the likeliest is the one that is nearest in the metric of the fit, the inverse of its
covariance. Everything else that was fitted follows, as it does once that body is given.

Source: Wensing, Kim and Slotine, "Linear matrix inequalities for physically consistent inertial
parameter identification", RA-L 2018.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.hypotheses.improvement import body_of
from estimators.diagnosis.hypotheses.revision import relative_inertia
from estimators.diagnosis.wording import LINK_INERTIA
from estimators.rigid_body.consistent import nearest_body
from estimators.rigid_body.regressor import PER_LINK, parameters_of
from limo_driver.errors import DivergedError
from limo_driver.physics import Payload

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.selection.candidates import Candidate
    from estimators.regression.evidence import Posterior
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray


def with_possible_bodies(
    model: RobotModel, members: Sequence[Candidate], fitted: Posterior
) -> FloatArray:
    """Return the coefficients (m,) of a fit, moved so that every body can exist.

    Args:
        model: The nominal bodies; one that is itself impossible is left as it is fitted.
        members: The set that was fitted.
        fitted: Coefficients of the nuisance, bodies first, then of the set.
    """
    mean, covariance = fitted.mean, fitted.covariance
    for nominal, of_body in _bodies(model, members, mean.size):
        body = nominal + of_body @ mean
        if not body.any() or _exists(body) or (nominal.any() and not _exists(nominal)):
            continue
        across = covariance @ of_body.T  # (m, 10)
        spread = of_body @ across
        if not _is_free(spread):
            continue  # held in part, where the nearest cannot be told
        try:
            nearest = nearest_body(body, np.linalg.inv(spread).astype(np.float64))
        except DivergedError:
            continue  # whoever writes it down makes it a body that exists
        gain = np.linalg.solve(spread, across.T).T
        mean = mean + gain @ (nearest - body)
        covariance = covariance - gain @ across.T  # a body that is drawn stays where it is
    return mean


def _is_free(spread: FloatArray) -> bool:
    """Say whether a covariance leaves every parameter of a body free, whatever their units."""
    scale = np.sqrt(np.diag(spread))
    if not scale.all():
        return False
    rank = np.linalg.matrix_rank(spread / np.outer(scale, scale), hermitian=True)
    return int(rank) == PER_LINK


def _exists(parameters: FloatArray) -> bool:
    body = body_of(parameters)
    return body is not None and body.is_consistent()


def _bodies(
    model: RobotModel, members: Sequence[Candidate], size: int
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the nominal parameters (10,) of each body, and what coefficients add to them (10, m).

    A payload is a body of its own, since the simulation has it beside the link that carries it. Of
    one that is stated, only the mass may be another.
    """
    links = [model.inertials[name] for name in model.link_names]
    changes = [np.zeros((PER_LINK, size)) for _ in links]
    for link, body in enumerate(links):
        own = slice(PER_LINK * link, PER_LINK * (link + 1))  # bodies come first
        changes[link][:, own] = relative_inertia(body)
    at = size - sum(candidate.prior.index.size for candidate in members)
    for candidate in members:
        own = slice(at, at + candidate.prior.index.size)
        if candidate.effect == LINK_INERTIA:
            link = int(model.linkage.own[candidate.joints[0]])
            changes[link][:, own] = relative_inertia(links[link])
        elif candidate.effect == Payload.name and candidate.kind == "missing":
            alone = np.zeros((PER_LINK, size))
            alone[:, own] = np.eye(PER_LINK)
            yield np.zeros(PER_LINK), alone
        at = own.stop
    yield from zip(map(parameters_of, links), changes, strict=True)
