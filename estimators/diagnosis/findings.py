"""Findings: what was found, with parameters and intervals, place and evidence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.confidence import confidence_of
from estimators.diagnosis.improvement import Improvement
from estimators.diagnosis.judgement import FORETOLD, contribution, equivalents, identical, margin
from estimators.diagnosis.proof import rmse
from estimators.diagnosis.verdict import UNKNOWN, BeforeAfter, Finding, Interval, Where
from estimators.diagnosis.wording import SIGNATURES
from limo_driver.physics import spoken

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.candidates import Candidate
    from estimators.diagnosis.judgement import Leftover
    from estimators.diagnosis.pipeline import Bench, Solution
    from limo_driver.physics import Effect
    from limo_driver.types import FloatArray

_DRAWS = 60  # of a posterior, for intervals
_LEAST = 1e-9  # coefficient of what is there
_ON_ALL = {"payload", "link_inertia"}  # of one body, felt by all joints below it
_NARROW, _WIDE = 0.5, 2.0  # ratio of medians at which a region is worth a word


def findings_of(
    bench: Bench,
    solution: Solution,
    final: Solution,
    named: Sequence[int],
    leftover: Leftover,
    after: FloatArray,
) -> tuple[Finding, ...]:
    """Return the findings of named members, the largest share first."""
    none = solution.search.evidence.posterior(solution.search.prior(()))
    reducible = np.maximum(
        rmse(bench.left(none), bench.split.held_out) ** 2 - leftover.floor**2, 0.0
    ).sum()
    found: list[Finding] = []
    for member in named:
        candidate = bench.candidates[member]
        same = equivalents(bench, solution, member)
        gained = contribution(bench, solution, member)
        share = float(np.clip(gained.sum() / max(reducible, 1e-12), 0.0, 1.0))
        everywhere = candidate.effect in _ON_ALL or not candidate.joints
        own = list(range(bench.observed.n) if everywhere else candidate.joints)
        joint = own[int(np.argmax((gained / leftover.floor**2)[own]))]
        lead = margin(bench, solution, member, same)
        before = np.sqrt(np.maximum(after**2 + gained, 0.0))
        found.append(
            Finding(
                effect=candidate.effect,
                kind=candidate.kind,
                joints=tuple(j + 1 for j in candidate.joints or range(bench.observed.n)),
                equivalent=tuple(
                    dict.fromkeys(
                        effect
                        for effect in (*identical(bench, member), *(c.effect for c in same))
                        if effect != candidate.effect
                    )
                ),
                confidence=confidence_of(
                    lead=lead,
                    material=float(np.sqrt(max(gained[joint], 0.0)) / leftover.floor[joint]),
                    foretold=float(leftover.foretold[joint] / leftover.floor[joint]),
                    rivals=len({c.effect for c in same}),
                ),
                parameters=_parameters(bench, final, member),
                where=_where(bench, solution, member, joint),
                share=share,
                heldout_rmse=BeforeAfter(tuple(before.tolist()), tuple(after.tolist())),
                evidence=_sentence(
                    candidate,
                    joint,
                    float(before[joint]),
                    float(after[joint]),
                    float(leftover.floor[joint]),
                    lead,
                ),
            )
        )
    return tuple(sorted(found, key=lambda item: -item.share))


def _sentence(
    candidate: Candidate, joint: int, before: float, after: float, floor: float, lead: float
) -> str:
    return (
        f"At joint {joint + 1} {SIGNATURES[candidate.effect]}; on motion held out, it brings the "
        f"error there from {before:.3f} to {after:.3f} N m (noise floor {floor:.3f} N m), and the "
        f"recordings speak for it {_how(lead)} the next explanation."
    )


def _how(lead: float) -> str:
    """Say a lead of evidence [nat] as odds."""
    if lead <= 0:
        return "no more than for"
    power = lead / np.log(10.0)
    odds = f"{np.exp(lead):.0f} times" if power < 3 else f"10^{min(power, 99):.0f} times"  # noqa: PLR2004
    return odds + " more than for" if power < 99 else "beyond doubt against"  # noqa: PLR2004


def _parameters(bench: Bench, solution: Solution, member: int) -> dict[str, Interval]:
    """Return the parameters of the found effects, with intervals from draws of the posterior."""
    mean, covariance = amplitudes(bench, solution, member)
    candidate = bench.candidates[member]
    random = np.random.default_rng(0)
    lower = np.linalg.cholesky(covariance + 1e-18 * np.eye(mean.size))
    drawn: list[dict[str, Any]] = []
    for k in range(_DRAWS):
        c = mean if k == 0 else mean + lower @ random.standard_normal(mean.size)
        # what was found to be zero stays so, or a list would be shorter in one draw than in another
        c = np.where(candidate.prior.positive, np.where(mean > 0, np.maximum(c, _LEAST), 0.0), c)
        improvement = Improvement(bench.observed.simulation)
        try:
            candidate.enter(improvement, c)
        except ValueError:
            continue
        drawn.append(_values(candidate, improvement, bench))
    if not drawn:
        return {}
    first = drawn[0]
    result: dict[str, Interval] = {}
    for name, (value, unit) in first.items():
        rows = [d[name][0] for d in drawn if name in d]
        same = [r for r in rows if np.shape(r) == np.shape(value)]
        if isinstance(value, str):
            result[name] = Interval(value, unit)
            continue
        low, high = np.quantile(np.array(same, dtype=float), (0.025, 0.975), axis=0)
        if np.ndim(value):
            pairs = tuple(zip(np.ravel(low).tolist(), np.ravel(high).tolist(), strict=True))
            result[name] = Interval(tuple(np.ravel(value).tolist()), unit, pairs)
        else:
            result[name] = Interval(float(value), unit, (float(low), float(high)))
    return result


def amplitudes(bench: Bench, solution: Solution, member: int) -> tuple[FloatArray, FloatArray]:
    """Return a member's coefficients and their covariance."""
    at = bench.nuisance.prior.index.size
    for i in solution.members:
        size = bench.candidates[i].prior.index.size
        if i == member:
            rows = slice(at, at + size)
            return solution.fitted.mean[rows], solution.fitted.covariance[rows, rows]
        at += size
    raise KeyError(member)


def _values(candidate: Candidate, improvement: Any, bench: Bench) -> dict[str, tuple[Any, str]]:  # noqa: ANN401
    """Return name → (value, unit) of what a candidate enters."""
    if candidate.effect == "link_inertia":
        link = bench.observed.simulation.model.link_names[candidate.joints[0]]
        body = improvement.simulation().inertials[link]
        return {
            "mass": (body.mass, "kg"),
            "com": (body.com, "m"),
            "inertia": (body.inertia, "kg m^2"),
        }
    for effect in improvement.effects:
        if effect.name == candidate.effect and _acts(effect, candidate):
            return {
                known.name: (getattr(effect, known.name), known.unit)
                for known in effect.parameters()
                if getattr(effect, known.name) not in (None, ())
            }
    return {}


def _acts(effect: Effect, candidate: Candidate) -> bool:
    joint = getattr(effect, "joint", None)
    return joint is None or joint - 1 in candidate.joints


def _where(bench: Bench, solution: Solution, member: int, joint: int) -> Where:
    mean, _ = amplitudes(bench, solution, member)
    torque = bench.columns.apply(bench.candidates[member].prior.index, mean)[:, joint]
    weight = torque**2
    observed = bench.observed
    slow = observed.slow
    words: list[str] = []
    for name, values, unit in (
        ("|speed|", np.abs(slow.velocity[:, joint]), "rad/s"),
        ("distance since reversal", observed.since_reversal[observed.kept, joint], "rad"),
        ("|load|", np.abs(observed.load[observed.kept, joint]), "N m"),
    ):
        order = np.argsort(values)
        total = np.cumsum(weight[order])
        half = float(values[order][min(np.searchsorted(total, 0.5 * total[-1]), len(order) - 1)])
        usual = float(np.median(values))
        if usual > 0 and not _NARROW < half / usual < _WIDE:
            size, side = ("small", "below") if half < usual else ("large", "above")
            words.append(f"{size} {name} (half of it {side} {half:.2g} {unit})")
    text = f"joint {joint + 1}" + (": " + ", ".join(words) if words else ", all over the motion")
    return Where(region=text, figure=f"joint-{joint + 1}")


def unknown_of(
    bench: Bench,
    stand_ins: Sequence[int],
    rest: Leftover,
    joints: tuple[int, ...],
    after: FloatArray,
) -> tuple[Finding, ...]:
    """Return the finding of what nothing explains, if there is something.

    Args:
        bench: What was compared.
        stand_ins: Members that improve the prediction, and explain too little to be named.
        rest: What is left on each joint.
        joints: Where something unknown acts, 0-based.
        after: Held-out RMSE of the improved simulation, (n,) [N m].
    """
    if not joints:
        return ()
    worst = max(joints, key=lambda j: rest.foretold[j] / rest.floor[j])
    ratio = float(rest.foretold[worst] / rest.floor[worst])
    confidence = 1.0 - 0.5 * float(np.exp(-(ratio - FORETOLD) / FORETOLD))
    text = (
        f"At joint {worst + 1} a rest of {rest.foretold[worst]:.3f} N m RMS could be foretold from "
        f"the motion (noise floor {rest.floor[worst]:.3f} N m), and no known effect foretells it."
    )
    if stand_ins:
        names = (
            f"{spoken(c.effect)} ({', '.join(str(j + 1) for j in c.joints) or 'arm'})"
            for c in (bench.candidates[member] for member in stand_ins)
        )
        text += (
            f" Until it is understood, {'; '.join(names)} stand in for part of it in the improved "
            "simulation; they are no names for it."
        )
    values = tuple(after.tolist())
    return (
        Finding(
            effect=UNKNOWN,
            kind="missing",
            joints=tuple(j + 1 for j in joints),
            equivalent=(),
            confidence=min(confidence, 0.99),
            parameters={},
            where=Where(region=f"joint {worst + 1}", figure=f"joint-{worst + 1}"),
            share=0.0,
            heldout_rmse=BeforeAfter(values, values),
            evidence=text,
        ),
    )
