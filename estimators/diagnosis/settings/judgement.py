"""Settings of the judgement: findings and their confidence, what stays unknown, and events."""

from __future__ import annotations

from estimators.diagnosis.settings import setting, settings

# A table: value, unit, meaning; what it trades; how it was chosen.
# fmt: off


@settings
class JUDGEMENT:
    """Abstention (judgement.judgement)."""

    predictable: float = setting(0.45, "noise floors",
        "of predictable residual that counts as unknown",
        "higher overlooks unknown physics; lower abstains too often",
        chosen="by judgement, changed once while developing on concealed cases: from 0.5")
    smoother: float = setting(1.4, "times the other joints'",
        "ratio of a residual to its roughness",
        "higher takes slow physics for noise; lower noise for physics")
    smooth: float = setting(1.9, "", "that ratio, at least", "as above")
    at_limit: float = setting(0.01, "sigma",
        "from the limit of a tolerance, at which a value is said to be there", "only wording")
    worth_a_word: float = setting(1.5, "sigma", "that a lag or offset of a sensor moved",
        "only wording: higher notes fewer")
    dominant: float = setting(0.96, "of a joint's predictable error",
        "that its findings have to explain",
        "higher abstains more often; lower names what stands in for the unknown",
        chosen="by judgement, changed once while developing on concealed cases: from 0.7")
    precise: float = setting(0.99, "of a joint's predictable error",
        "beyond which the remainder is imprecision of a law",
        "higher abstains more often; lower overlooks small unknown physics")


@settings
class ORDINARY:
    """Friction that is ordinary where none is stated (judgement.ordinary)."""

    compared: int = setting(4, "joints", "of one kind of friction, from which sizes are compared",
        "lower takes chance for scatter; higher compares on few arms")


@settings
class BLACK_BOX:
    """The black box that looks for unknown physics (judgement.surrogate)."""

    widths: tuple[float, float, int] = setting((3e-4, 0.06, 5), "rad",
        "of its stops: from, to, and how many",
        "more cost time and fit noise; fewer see less")
    speeds: tuple[float, float, int] = setting((0.002, 0.15, 4), "rad/s", "of its signs, likewise",
        "as above")
    ridges: tuple[float, float, int] = setting((1e-3, 1.0, 4), "of the mean energy of a feature",
        "of which the best is taken, likewise", "only bounds: the rows left out choose")
    folds: int = setting(5, "", "of time, each left out once",
        "more cost time; fewer train on less")
    hats: int = setting(12, "", "of its dependence on time",
        "more fit noise; fewer miss what changes quickly")
    at_rest: float = setting(1e-3, "rad/s", "below which a joint rests, for its stiction",
        "higher takes slow motion for rest; lower noise for motion")
    of_others: tuple[float, float] = setting((0.01, 0.05), "rad/s",
        "over which the other joints' signs turn, alone and as they change its own friction",
        "wider is viscous friction; narrower a step at reversals")


@settings
class QUESTIONS:
    """Questions asked of a residual (judgement.questions)."""

    least_evidence: float = setting(6.0, "nat", "for a yes",
        "higher says no to weak dependence; lower yes to chance")
    distances: tuple[float, float, int] = setting((1e-3, 0.15, 4), "rad",
        "over which friction may build up: from, to, and how many",
        "more cost time; fewer see less")
    hats: int = setting(5, "", "of a smooth dependence", "more fit noise; fewer see less")


@settings
class REGION:
    """Region in which a finding acts (judgement.region)."""

    part: float = setting(0.2, "of the rows",
        "that has half the energy, if a range of positions is worth a word", "only wording")
    brief: float = setting(1.0 / 3.0, "of the rows", "that those stretches have at most",
        "higher says a time where there is none in particular")


@settings
class OBSERVABLE:
    """Effects that the motion does not excite (judgement.conclusion)."""

    hidden: float = setting(10.0, "noise floors", "that could act and not be seen",
        "lower lists more; higher less")


@settings
class CONFIDENCE:
    """Confidence of a name (judgement.findings)."""

    weights: tuple[float, float, float] = setting((-3.4, 1.7, 1.4), "logit",
        "of 1, and of the logarithms of the size and of the duration [s]", "fitted, not chosen",
        chosen=("measured: logistic regression on 74 names in recordings of 11 sources and 28 of "
                "24 concealed plants (benchmarks/diagnosis/diagnosis_calibration.py)"))
    highest: float = setting(0.99, "", "that is ever said",
        "higher claims more than so few names can show")
    of_unknown: float = setting(0.75, "of the cases",
        "in which what nothing explained was unknown physics there", "a frequency, not a choice",
        chosen="measured on concealed cases")
    of_contact: tuple[float, float] = setting((-2.8, 1.1), "logit", "of 1 and log rarity [nat]",
        "fitted, not chosen",
        chosen=("measured: logistic regression on 114 stretches that looked like pushes in "
                "recordings of a UR10, a UR10e and an LWR4+, to which 73 of them were added"))


@settings
class GUESSES:
    """Tolerances that nobody stated (judgement.guesses)."""

    constant: float = setting(0.01, "of a torque", "that it differs from a constant times currents",
        "higher takes a sensor of torque for them; lower misses rounded ones")


@settings
class PUSHES:
    """The scan for pushes (contact)."""

    strongest: float = setting(100.0, "N or N m", "1 sigma of a wrench that is estimated",
        "larger leaves what is hardly seen free; smaller pulls strong pushes down")
    remembered: float = setting(4.0, "rows", "over which errors are alike",
        "more widen the intervals")
    one_wrench: float = setting(0.7, "of the squared errors of a push",
        "that one wrench at the flange explains where it is said to be one",
        "higher says it less often; lower tells of a wrench that acts elsewhere")
    lengths: tuple[float, float, int] = setting((0.25, 2.0, 4), "s",
        "of the scan's windows: from, to, and how many",
        "more cost time; fewer miss some lengths", chosen="from a hit to a human push")
    least_evidence: float = setting(120.0, "nat", "for a push, of all joints together",
        "higher misses weak pushes; lower takes for pushes what the arm does at times",
        chosen="a quarter above the largest that would be named on four arms without hits, "
               "beside simulations of other runs, which is 94")
    rare: float = setting(14.0, "nat", "how seldom what passes for a push has to be, by chance",
        "higher misses pushes on arms of much unknown physics; lower takes that for pushes",
        chosen="where a push is as likely as not, by the weights of its confidence")
    freedom: tuple[float, float] = setting((0.1, 1e4), "degrees of freedom",
        "of how stretches scatter, between which they are sought",
        "numerical: beyond those, all variances are one")
    joint: float = setting(3.0, "nat", "that the errors of each joint reach by chance",
        "higher misses what many joints feel a little; lower adds up noise")
    felt: float = setting(15.0, "nat", "for a joint that felt a push",
        "higher names fewer joints; lower some that did not")
    explained: float = setting(0.6, "of squared errors in and around it",
        "that the course of what one joint alone felt explains",
        "higher misses hits that rebound; lower takes vibration for hits")
    cut: float = setting(8.0, "of the usual error", "at which larger ones are cut to learn it",
        "higher learns from pushes; lower cuts what is usual")
    alike: float = setting(0.6, "of the averaged rows", "that are one independent row",
        "higher counts less evidence")
    judged: float = setting(0.8, "of a window", "in which a joint has to be judged",
        "higher counts fewer joints; lower those near rest")
    fewest: int = setting(30, "windows", "to learn what is usual",
        "more judge no short recordings; fewer know little")
    fewest_turns: int = setting(6, "reversals", "of a joint, other ones, to learn that",
        "more judge no short recordings about reversals; fewer know little")
    ends: float = setting(0.5, "s", "of motion at its start and end that is not judged",
        "longer leaves out motion; shorter takes braking for a push")
    apart: float = setting(1.0, "s", "between two pushes",
        "longer misses the second; shorter takes a rebound for another")
    shortest: float = setting(0.1, "s", "of a push", "shorter takes spikes for pushes",
        chosen="what a filter of 10 Hz makes of a hit")
    longest: float = setting(3.0, "s", "of a push", "longer takes drifts for pushes",
        chosen="above the 2 s of human pushes")
    pieces: int = setting(8, "", "constant stretches that a half sine is made of",
        "more cost time; fewer are less smooth")
    spread: float = setting(0.3, "s", "over which the filter spreads a push",
        "longer leaves out motion; shorter fits what is pushed")


@settings
class JOLTS:
    """Jolts, which ring beyond what slow physics reaches (residuals.jolts)."""

    outstanding: float = setting(5.0, "usual errors", "beyond which an error is no slow physics",
        "higher leaves jolts in the noise; lower leaves out what is odd about a motion",
        chosen="the second largest of all joints reaches 3.5 in 24 recordings of real and "
               "concealed arms without a jolt, 8 where two logs of an LWR4+ end as it brakes, and "
               "6 to 10 in the jolts of an xMate")
    most: float = setting(0.03, "of the rows of motion",
        "that are jolts, without those to which the filter spreads them",
        "more leave out what recurs; fewer keep the jolts of a rough motion")


@settings
class IMPACTS:
    """Impacts as play is passed, which are neither pushes nor jolts (residuals.impacts)."""

    alike: float = setting(0.8, "of squared errors in and around an event",
        "that it explains of further ones of a joint", "as above", chosen="as above")


@settings
class ROUNDS:
    """Events and effects in turn (events), and other sets around one (reconsidering)."""

    several: int = setting(3, "effects",
        "of which one may stand for what two others make of one another",
        "fewer search again more often, which costs time")
