"""Bodies: a fit of links and of a payload, drawn to the nearest ones that can exist.

The torque is linear in mass, first moments and inertia of a body, and a linear fit knows no bounds:
what little the motion shows of an inertia may come out as one that no body has. It is drawn to the
body that exists and whose torque is nearest, in units of what the fit leaves at each joint; what
else was fitted follows to keep that torque, as far as the fit leaves it open. Nearest in the metric
of the fit would be another body: under noise that is predicted from one row to the next, a slow
error of several newton metres costs less than a quick one of a tenth, and gravity would give way to
what little is known of an inertia.

Source: Wensing, Kim and Slotine, "Linear matrix inequalities for physically consistent inertial
parameter identification", RA-L 2018.
"""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.hypotheses.improvement import body_of
from estimators.diagnosis.hypotheses.revision import relative_inertia
from estimators.diagnosis.wording import LINK_INERTIA
from estimators.regression.evidence import REACH, joined
from estimators.rigid_body.consistent import nearest_body
from estimators.rigid_body.regressor import PER_LINK, parameters_of
from limo_driver.errors import DivergedError
from limo_driver.physics import Payload

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.selection.candidates import Candidate
    from estimators.regression.evidence import Posterior, Prior
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray


def with_possible_bodies(
    model: RobotModel,
    members: Sequence[Candidate],
    nuisance: Prior,
    fitted: Posterior,
    torques: Callable[[Prior], FloatArray],
) -> FloatArray:
    """Return the coefficients (m,) of a fit, moved so that every body can exist.

    Args:
        model: The nominal bodies; one that is itself impossible is left as it is fitted.
        members: The set that was fitted.
        nuisance: Prior of the coefficients that come first.
        fitted: Coefficients of the nuisance, bodies first, then of the set.
        torques: Returns products (m, m) of the torques of all of them, beside their prior.
    """
    mean, prior = fitted.mean.copy(), joined(nuisance, *(item.prior for item in members))
    known = cache(partial(torques, prior))
    drawn: list[NDArray[np.int64]] = []
    for nominal, of_body, own in _bodies(model, members, mean.size):
        body = nominal + of_body @ mean
        if not body.any() or _exists(body) or (nominal.any() and not _exists(nominal)):
            continue
        if not _is_free(of_body @ fitted.covariance @ of_body.T):
            continue  # held in part, where the nearest cannot be told
        back = np.linalg.inv(of_body[:, own]).astype(np.float64)
        try:
            nearest = nearest_body(body, back.T @ known()[np.ix_(own, own)] @ back)
        except DivergedError:
            continue  # whoever writes it down makes it a body that exists
        mean[own] += back @ (nearest - body)
        drawn.append(own)
    if not drawn:
        return mean
    moved = np.concatenate(drawn)
    open_to = np.diag(fitted.covariance)
    rest = np.setdiff1d(np.flatnonzero(open_to > 0), moved)
    change = known()[np.ix_(rest, moved)] @ (mean - fitted.mean)[moved]
    stiff = known()[np.ix_(rest, rest)] + np.diag(1.0 / open_to[rest])
    mean[rest] -= np.linalg.solve(stiff, change)
    most = np.where(np.arange(mean.size) < nuisance.index.size, REACH * prior.deviation, np.inf)
    return np.clip(mean, np.where(prior.positive, 0.0, -most), most)


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
) -> Iterator[tuple[FloatArray, FloatArray, NDArray[np.int64]]]:
    """Yield each body's nominal parameters (10,), what coefficients add (10, m), and its own (10,).

    A payload is a body of its own, since the simulation has it beside the link that carries it. Of
    one that is stated, only the mass may be another.
    """
    links = [model.inertials[name] for name in model.link_names]
    changes = [np.zeros((PER_LINK, size)) for _ in links]
    last = [PER_LINK * link + np.arange(PER_LINK) for link in range(len(links))]
    for link, body in enumerate(links):
        changes[link][:, last[link]] = relative_inertia(body)  # bodies come first
    at = size - sum(candidate.prior.index.size for candidate in members)
    for candidate in members:
        own = at + np.arange(candidate.prior.index.size)
        if candidate.effect == LINK_INERTIA:
            link = int(model.linkage.own[candidate.joints[0]])
            changes[link][:, own] = relative_inertia(links[link])
            last[link] = own
        elif candidate.effect == Payload.name and candidate.kind == "missing":
            alone = np.zeros((PER_LINK, size))
            alone[:, own] = np.eye(PER_LINK)
            yield np.zeros(PER_LINK), alone, own
        at += own.size
    yield from zip(map(parameters_of, links), changes, last, strict=True)
