"""Settings of judgement, report and next motion: findings, what stays unknown, events, bins."""

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
    precise: float = setting(0.99, "of a joint's predictable error",
        "beyond which the remainder is imprecision of a law",
        "higher abstains more often; lower overlooks small unknown physics")
    dominant: float = setting(0.96, "of a joint's predictable error",
        "that its findings have to explain",
        "higher abstains more often; lower names what stands in for the unknown",
        chosen="by judgement, changed once while developing on concealed cases: from 0.7")
    smoother: float = setting(1.4, "times the other joints'",
        "ratio of a residual to its roughness",
        "higher takes slow physics for noise; lower noise for physics")
    smooth: float = setting(1.9, "", "that ratio, at least", "as above")


@settings
class BLACK_BOX:
    """The black box that looks for unknown physics (judgement.surrogate)."""

    hats: int = setting(12, "", "of its dependence on time",
        "more fit noise; fewer miss what changes quickly")
    widths: tuple[float, float, int] = setting((3e-4, 0.06, 5), "rad",
        "of its stops: from, to, and how many",
        "more cost time and fit noise; fewer see less")
    speeds: tuple[float, float, int] = setting((0.002, 0.15, 4), "rad/s", "of its signs, likewise",
        "as above")
    ridges: tuple[float, float, int] = setting((1e-3, 1.0, 4), "of the mean energy of a feature",
        "of which the best is taken, likewise", "only bounds: the rows left out choose")
    folds: int = setting(5, "", "of time, each left out once",
        "more cost time; fewer train on less")
    at_rest: float = setting(1e-3, "rad/s", "below which a joint rests, for its stiction",
        "higher takes slow motion for rest; lower noise for motion")
    of_others: tuple[float, float] = setting((0.01, 0.05), "rad/s",
        "over which the other joints' signs turn, alone and as they change its own friction",
        "wider is viscous friction; narrower a step at reversals")


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
class PUSHES:
    """The scan for pushes (contact)."""

    strongest: float = setting(100.0, "N or N m", "1 sigma of a wrench that is estimated",
        "larger leaves what is hardly seen free; smaller pulls strong pushes down")
    remembered: float = setting(4.0, "rows", "over which errors are alike",
        "more widen the intervals")
    lengths: tuple[float, float, int] = setting((0.25, 2.0, 4), "s",
        "of the scan's windows: from, to, and how many",
        "more cost time; fewer miss some lengths", chosen="from a hit to a human push")
    least_evidence: float = setting(120.0, "nat", "for a push, of all joints together",
        "higher misses weak pushes; lower takes for pushes what the arm does at times",
        chosen="a quarter above the largest that would be named on four arms without hits, "
               "beside simulations of other runs, which is 94")
    joint: float = setting(3.0, "nat", "that the errors of each joint reach by chance",
        "higher misses what many joints feel a little; lower adds up noise")
    felt: float = setting(15.0, "nat", "for a joint that felt a push",
        "higher names fewer joints; lower some that did not")
    alike: float = setting(0.6, "of the averaged rows", "that are one independent row",
        "higher counts less evidence")
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
    cut: float = setting(8.0, "of the usual error", "at which larger ones are cut to learn it",
        "higher learns from pushes; lower cuts what is usual")
    explained: float = setting(0.6, "of squared errors in and around it",
        "that the course of what one joint alone felt explains",
        "higher misses hits that rebound; lower takes vibration for hits")
    judged: float = setting(0.8, "of a window", "in which a joint has to be judged",
        "higher counts fewer joints; lower those near rest")
    rare: float = setting(14.0, "nat", "how seldom what passes for a push has to be, by chance",
        "higher misses pushes on arms of much unknown physics; lower takes that for pushes",
        chosen="where a push is as likely as not, by the weights of its confidence")
    fewest: int = setting(30, "windows", "to learn what is usual",
        "more judge no short recordings; fewer know little")
    freedom: tuple[float, float] = setting((0.1, 1e4), "degrees of freedom",
        "of how stretches scatter, between which they are sought",
        "numerical: beyond those, all variances are one")


@settings
class ROUNDS:
    """Events and effects in turn (events), and other sets around one (reconsidering)."""

    several: int = setting(3, "effects",
        "of which one may stand for what two others make of one another",
        "fewer search again more often, which costs time")


@settings
class ORDINARY:
    """Friction that is ordinary where none is stated (judgement.ordinary)."""

    compared: int = setting(4, "joints", "of one kind of friction, from which sizes are compared",
        "lower takes chance for scatter; higher compares on few arms")


@settings
class JOLTS:
    """Jolts, which ring beyond what slow physics reaches (residuals.jolts)."""

    most: float = setting(0.03, "of the rows of motion",
        "that are jolts, without those to which the filter spreads them",
        "more leave out what recurs; fewer keep the jolts of a rough motion")


@settings
class SEPARATION:
    """The motion in which two explanations differ (limo_driver.app.library.diagnosing)."""

    start_poses: int = setting(6, "poses", "of each recording, around which it is planned",
        "more cost time; fewer find worse motions, or none")


@settings
class REPLAY:
    """Recorded motion on the simulated robot (limo_driver.app.library.diagnosing)."""

    rate: float = setting(100.0, "Hz", "of the rows that are kept of it",
        "more make the report larger; fewer blur what is quick")


@settings
class BINS:
    """Bins and cells in which the report averages a residual (report.binning)."""

    rows: float = setting(10.0, "rows", "of a bin in the mean, where there are not enough for all",
        "more blur what the residual follows; fewer draw noise")
    most: int = setting(32, "bins", "of a profile", "more draw noise; fewer blur")
    fewest: int = setting(5, "bins", "of a profile of however few rows",
        "more are empty; fewer say nothing")


@settings
class LOOPS:
    """Loops of torque over position that the report shows (report.stretch)."""

    duration: float = setting(8.0, "s", "of motion drawn as loops",
        "longer covers them with other loops; shorter shows part of one")


@settings
class WORDING:
    """What is worth a word (headline, wording, verdict, report)."""

    listed: int = setting(3, "items", "that a sentence names, or a page shows at once",
        "only wording")
    beyond_doubt: float = setting(1e6, "to 1", "odds beyond which a figure says no more than words",
        "only wording")
    at_floor: float = setting(1.15, "noise floors", "up to which an error is at the floor",
        "only wording: higher calls small errors noise",
        chosen="the floor is an estimate itself")
    from_start: float = setting(1.0, "s", "after a free run begins, from which on that is asked",
        "longer leaves less to ask; shorter takes what an unknown start makes for physics")
    explanations: int = setting(12, "sets", "of effects that are listed as having competed",
        "more make the report longer; fewer hide how near others came")
