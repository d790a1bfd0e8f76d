"""Conclusion: the verdict in the words and numbers of `verdict.json`."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.confidence import confidence_of
from estimators.diagnosis.diagnosis import Explanation, Shift
from estimators.diagnosis.judgement import FORETOLD, contribution, equivalents, identical, margin
from estimators.diagnosis.plausibility import notes_on
from estimators.diagnosis.proof import bootstrap, reducible_removed, rmse
from estimators.diagnosis.verdict import (
    UNKNOWN,
    BeforeAfter,
    Finding,
    Fit,
    Interval,
    NotObservable,
    RowCount,
    Unexplained,
    Verdict,
    Where,
)
from estimators.diagnosis.wording import SIGNATURES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.candidates import Candidate
    from estimators.diagnosis.judgement import Leftover
    from estimators.diagnosis.pipeline import Bench, Solution
    from limo_driver.physics import Effect, Simulation
    from limo_driver.recording import Recording
    from limo_driver.types import FloatArray

_DRAWS = 60  # of a posterior, for intervals
_LEAST = 1e-9  # coefficient of what is there
_NARROW, _WIDE = 0.5, 2.0  # ratio of medians at which a region is worth a word


def findings_of(
    bench: Bench, solution: Solution, final: Solution, leftover: Leftover, after: FloatArray
) -> tuple[Finding, ...]:
    """Return the named findings, the largest share first."""
    none = solution.search.evidence.posterior(solution.search.prior(()))
    reducible = np.maximum(
        rmse(bench.left(none), bench.split.held_out) ** 2 - leftover.floor**2, 0.0
    ).sum()
    found: list[Finding] = []
    for member in solution.members:
        candidate = bench.candidates[member]
        same = equivalents(bench, solution, member)
        gained = contribution(bench, solution, member)
        share = float(np.clip(gained.sum() / max(reducible, 1e-12), 0.0, 1.0))
        own = list(candidate.joints or range(bench.observed.n))
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
    from estimators.diagnosis.improvement import Improvement

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


def fit_of(bench: Bench, before: FloatArray, after: FloatArray, floor: FloatArray) -> Fit:
    """Return the proof: residuals (K, n) of both simulations on held-out rows."""
    rows = bench.split.held_out
    b, a = rmse(before, rows), rmse(after, rows)
    return Fit(
        tuple(b.tolist()),
        tuple(a.tolist()),
        tuple(floor.tolist()),
        reducible_removed(b, a, floor),
        bootstrap(before, after, floor, bench.observed, rows),
    )


def rows_of(recordings: Sequence[Recording]) -> RowCount:
    """Count the rows used and left out, by reason."""
    left_out: dict[str, int] = {}
    for recording in recordings:
        for item in recording.left_out:
            left_out[item.reason] = left_out.get(item.reason, 0) + len(item.rows)
    return RowCount(sum(map(len, recordings)), left_out)


def conclude(
    bench: Bench,
    solution: Solution,
    final: Solution,
    rest: Leftover,
    unknown: tuple[int, ...],
    proven: FloatArray,
    contact: tuple[Finding, ...] = (),
) -> Verdict:
    """Put the verdict together.

    Args:
        bench: What was compared.
        solution: The set, fitted to the rows meant for it.
        final: The same set, fitted to all rows: its parameters are reported.
        rest: What is left.
        unknown: Joints (0-based) on which something unknown acts.
        proven: Residual (K, n) of the improved simulation, not fitted to held-out rows [N m].
        contact: Pushes that were found.
    """
    after = rmse(proven, bench.split.held_out)
    named = (*contact, *findings_of(bench, solution, final, rest, after))
    findings = (*named, *_unknown(rest, unknown, after))
    if not findings:
        summary = "consistent"
    elif not unknown:
        summary = "explained"
    else:
        summary = "partly_explained" if named else "unexplained"
    total = rest.foretold**2 + np.maximum(after**2 - rest.floor**2, 0.0)
    share = tuple(float(rest.foretold[j] ** 2 / max(total[j], 1e-12)) for j in unknown)
    return Verdict(
        verdict=summary,
        findings=findings,
        unexplained=Unexplained(tuple(j + 1 for j in unknown), share),
        not_observable=not_observable(bench, solution, rest),
        next_motion=None,
        fit=fit_of(bench, bench.residual, proven, rest.floor),
        rows=rows_of(bench.observed.recordings),
        notes=notes_on(bench.observed),
    )


def agreed(verdict: Verdict, improved: Simulation) -> Verdict:
    """Give single-valued parameters the value that the improved simulation has; move intervals."""
    findings: list[Finding] = []
    for finding in verdict.findings:
        parameters = dict(finding.parameters)
        for effect in improved.effects:
            if effect.name != finding.effect or effect.joints != finding.joints:
                continue
            for name, known in finding.parameters.items():
                value, ci = getattr(effect, name), known.ci95
                if isinstance(value, float) and isinstance(known.value, float) and ci:
                    moved = tuple(limit + value - known.value for limit in ci)
                    parameters[name] = replace(known, value=value, ci95=moved)
        findings.append(replace(finding, parameters=parameters))
    return replace(verdict, findings=tuple(findings))


def _unknown(rest: Leftover, joints: tuple[int, ...], after: FloatArray) -> tuple[Finding, ...]:
    if not joints:
        return ()
    worst = max(joints, key=lambda j: rest.foretold[j] / rest.floor[j])
    ratio = float(rest.foretold[worst] / rest.floor[worst])
    confidence = 1.0 - 0.5 * float(np.exp(-(ratio - FORETOLD) / FORETOLD))
    text = (
        f"At joint {worst + 1} a rest of {rest.foretold[worst]:.3f} N m RMS could be foretold from "
        f"the motion (noise floor {rest.floor[worst]:.3f} N m), and no known effect foretells it."
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


def not_observable(bench: Bench, solution: Solution, rest: Leftover) -> tuple[NotObservable, ...]:
    """Name the effects that could be there at ten noise floors without showing."""
    evidence = solution.search.evidence
    size = bench.columns.size()
    least: dict[str, tuple[float, int]] = {}
    moves = np.count_nonzero(bench.observed.moving, axis=0) > 0
    for candidate in bench.candidates:
        if not np.all(moves[list(candidate.joints)]):
            continue  # a note says so
        at = candidate.prior.index
        information = np.diag(evidence.gram)[at]
        joint = candidate.joints[0] if candidate.joints else 0
        torque = float(
            np.min(size[at] * np.sqrt(2 * _PRICE / np.maximum(information, 1e-12)))
            / rest.floor[joint]
        )
        known = least.get(candidate.effect)
        if known is None or torque > known[0]:
            least[candidate.effect] = (torque, joint)
    return tuple(
        NotObservable(
            effect,
            f"at joint {joint + 1} it would have to add {torque * rest.floor[joint]:.2g} N m RMS "
            "to show beside what the tolerances allow",
        )
        for effect, (torque, joint) in sorted(least.items())
        if torque > _HIDDEN
    )


_PRICE = 10.0  # [nat] that an effect has to bring
_HIDDEN = 10.0  # [noise floors]


def explanations_of(bench: Bench, solution: Solution, limit: int = 12) -> tuple[Explanation, ...]:
    """Return the chosen set and the best others, best first."""
    search, rows = solution.search, bench.split.held_out
    none = rmse(bench.left(search.evidence.posterior(search.prior(()))), rows)
    floor = rmse(bench.left(solution.fitted), rows)
    sets = {tuple(sorted(solution.members))}
    for member in solution.members:
        rest = tuple(i for i in solution.members if i != member)
        sets |= {item.members for item in search.ranked(rest, limit)} | {tuple(sorted(rest))}
    sets |= {item.members for item in search.ranked((), limit)}
    best: dict[tuple[tuple[str, tuple[int, ...]], ...], tuple[int, ...]] = {}
    for members in sorted(sets, key=search.gain):
        best[tuple(bench.candidates[i].place for i in members)] = members
    ranked = sorted(best.values(), key=lambda members: -search.gain(members))[:limit]
    found: list[Explanation] = []
    for members in ranked:
        left = rmse(bench.left(search.evidence.posterior(search.prior(members))), rows)
        chosen = set(members) == set(solution.members)
        found.append(
            Explanation(
                tuple(bench.candidates[i].effect for i in members),
                tuple(tuple(j + 1 for j in bench.candidates[i].joints) for i in members),
                search.gain(members),
                reducible_removed(none, left, np.minimum(floor, none)),
                "chosen" if chosen else "",
            )
        )
    return tuple(found)


def shifts_of(bench: Bench, final: Solution) -> tuple[Shift, ...]:
    """Return how far each nuisance parameter moved, in its own tolerance, farthest first."""
    count = bench.nuisance.prior.index.size
    mean = final.fitted.mean[:count]
    sigmas = mean / bench.nuisance.prior.deviation
    order = np.argsort(-np.abs(sigmas))
    return tuple(
        Shift(
            bench.nuisance.names[k],
            float(bench.nuisance.nominal[k]),
            float(bench.nuisance.nominal[k] * (1.0 + mean[k])),
            "relative",
            float(sigmas[k]),
        )
        for k in order
    )
