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
    most: float = setting(0.75, "of a joint's predictable error",
        "the same, where what remains is small", "as above",
        chosen="by judgement on real recordings, whose small remainders no catalogue explains")
    small: float = setting(1.0, "noise floors", "of predictable residual that counts as small",
        "higher names more beside unknown physics; lower calls all of it unknown",
        chosen="what stands in for concealed unknown physics leaves more, or explains less")
    precise: float = setting(0.99, "of a joint's predictable error",
        "beyond which the remainder is imprecision of a law",
        "higher abstains more often; lower overlooks small unknown physics")


@settings
class ORDINARY:
    """Friction that is ordinary where none is stated (judgement.ordinary)."""

    part: float = setting(0.5, "of the joints of unknown friction",
        "more than which have what is ordinary",
        "higher names what an arm has all over; lower hides what half of its joints have")
    siblings: int = setting(3, "joints", "that such an arm is taken to have at least",
        "lower takes what one of two joints has for ordinary",
        chosen="of fewer than three joints, none is unlike the others")
    compared: int = setting(4, "joints", "of one kind of friction, from which sizes are compared",
        "lower takes chance for scatter; higher compares on few arms")
    times: float = setting(3.0, "times any sibling's", "that friction unlike its siblings is",
        "higher misses a joint that binds; lower names what another gear makes",
        chosen="the UR10e's joints differ by 3 in all, the Panda's two kinds of gears by 10")


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
    waves: int = setting(3, "per revolution",
        "of its dependence on position, from one on", "more fit noise; fewer see less")
    hats: int = setting(12, "", "of its dependence on time",
        "more fit noise; fewer miss what changes quickly")
    at_rest: float = setting(1e-3, "rad/s", "below which a joint rests, for its stiction",
        "higher takes slow motion for rest; lower noise for motion")
    fades: float = setting(0.3, "s", "over which stiction fades once a joint moves",
        "longer looks like dry friction; shorter is gone within few rows")
    of_others: tuple[float, float] = setting((0.01, 0.05), "rad/s",
        "over which the other joints' signs turn, alone and as they change its own friction",
        "wider is viscous friction; narrower a step at reversals")


@settings
class QUESTIONS:
    """Questions asked of a residual (judgement.questions)."""

    least_evidence: float = setting(6.0, "nat", "for a yes",
        "higher says no to weak dependence; lower yes to chance")
    least_share: float = setting(0.05, "of the reducible error held out", "for a yes", "as above")
    distances: tuple[float, float, int] = setting((1e-3, 0.15, 4), "rad",
        "over which friction may build up: from, to, and how many",
        "more cost time; fewer see less")
    hats: int = setting(5, "", "of a smooth dependence", "more fit noise; fewer see less")
    least_reducible: float = setting(0.1, "of the floor", "that shares are taken of at least",
        "lower gives shares of noise; higher understates")


@settings
class REGION:
    """Region in which a finding acts (judgement.region)."""

    wide: float = setting(2.0, "ratio of medians",
        "above which a region is worth a word, or below its inverse", "only wording")
    part: float = setting(0.2, "of the rows",
        "that has half the energy, if a range of positions is worth a word", "only wording")
    most: float = setting(0.75, "of the energy in a recording", "that its stretch of time holds",
        "higher gives longer stretches")
    all: float = setting(0.9, "of the energy in all recordings",
        "that those with a stretch hold together", "higher names more recordings")
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
class HOLDING:
    """Motion on which a verdict stands (judgement.holding)."""

    open: float = setting(0.9, "of its tolerance",
        "that a value is still uncertain by, if it is said to stay as stated",
        "lower says it of values that are known better; higher says it of few")


@settings
class VALUES:
    """Stated values that are reported (judgement.stated_values)."""

    sure: float = setting(3.0, "standard deviations",
        "that a value that fits is from the stated one",
        "lower tells chance; higher less that differs",
        chosen="some twenty values of an arm are looked at")
    doubtless: float = setting(6.0, "standard deviations",
        "the same, where the joint errs hardly more than noise", "as above",
        chosen="an armature off by 38 % and 30 deviations left an error of 1.12 noise floors")
    share: float = setting(0.1, "of a joint's reducible error", "that goes with it",
        "lower tells what hardly matters; higher leaves unsaid what moved")


@settings
class GUESSES:
    """Tolerances that nobody stated (judgement.guesses)."""

    gain: float = setting(0.1, "relative", "deviation of the scale of torques that are currents",
        "higher lets loads go into gains; lower takes a wrong constant of a motor for a tilt",
        chosen="constants of motors in data sheets are good to a tenth")
    constant: float = setting(0.01, "of a torque", "that it differs from a constant times currents",
        "higher takes a sensor of torque for them; lower misses rounded ones")
    times: float = setting(2.0, "times a guessed tolerance", "that is tried, and its inverse",
        "more cost time; fewer say less of what a guess decides")


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
    determined: float = setting(0.5, "of a push's force",
        "half the widest interval of its components, up to which its size is said",
        "larger says forces that a pose hardly tells; smaller keeps quiet of known ones")
    lengths: tuple[float, float, int] = setting((0.25, 2.0, 4), "s",
        "of the scan's windows: from, to, and how many",
        "more cost time; fewer miss some lengths", chosen="from a hit to a human push")
    smoothed: float = setting(0.1, "s", "over which errors are averaged",
        "longer misses short hits; shorter takes single errors for hits",
        chosen="by hits added to what the simulations of three real arms leave: of 0.05, 0.1 and "
               "0.2 s it finds most at no false one")
    scattered: float = setting(0.2, "s", "over which they are to tell how they scatter",
        "longer tells less of it; shorter takes single errors for scatter",
        chosen="that by which the confidence of pushes was learned")
    least_evidence: float = setting(120.0, "nat", "for a push, of all joints together",
        "higher misses weak pushes; lower takes for pushes what the arm does at times",
        chosen="a quarter above the largest that would be named on four arms without hits, "
               "beside simulations of other runs, which is 94")
    rare: float = setting(14.0, "nat", "how seldom what passes for a push has to be, by chance",
        "higher misses pushes on arms of much unknown physics; lower takes that for pushes",
        chosen="where a push is as likely as not, by the weights of its confidence")
    scatter: float = setting(0.75, "quantile", "of other stretches, that tells how they scatter",
        "higher counts other pushes as scatter; lower tells less of the largest")
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
    many: int = setting(3, "joints", "that feel a push over the start or end of a motion",
        "more miss pushes there; fewer take friction for them")
    outstanding: float = setting(3.0, "times the next", "evidence of what one joint alone felt",
        "higher misses hits that one joint feels; lower takes friction and sensors for hits")
    of_inertia: float = setting(1.0, "of usual errors, for each usual torque of acceleration",
        "that errors grow by with the torque that the arm's own acceleration asks for",
        "higher misses hits in fast motion; lower takes vibration after a jerk for a hit",
        chosen="as smoothed; 0 and 0.5 find a vibration in recordings of a real arm")
    cut: float = setting(8.0, "of the usual error", "at which larger ones are cut to learn it",
        "higher learns from pushes; lower cuts what is usual")
    alike: float = setting(0.6, "of the averaged rows", "that are one independent row",
        "higher counts less evidence")
    judged: float = setting(0.8, "of a window", "in which a joint has to be judged",
        "higher counts fewer joints; lower those near rest")
    fewest: int = setting(30, "windows", "to learn what is usual",
        "more judge no short recordings; fewer know little")
    stops: float = setting(0.1, "of a joint's usual speed", "below which it all but stops",
        "higher judges less motion; lower takes a stop on the way for steady motion")
    at_turns: float = setting(0.9, "quantile",
        "of a joint's errors as long before or after its other reversals, that are usual there",
        "higher misses pushes over a reversal; lower takes friction that varies for them")
    fewest_turns: int = setting(6, "reversals", "of a joint, other ones, to learn that",
        "more judge no short recordings about reversals; fewer know little")
    usual: float = setting(3.0, "of the usual error", "beyond which errors are not as usual",
        "higher takes starting for pushes; lower misses pushes soon after a start")
    ends: float = setting(0.5, "s", "of motion at its start and end that is not judged",
        "longer leaves out motion; shorter takes braking for a push")
    apart: float = setting(1.0, "s", "between two pushes",
        "longer misses the second; shorter takes a rebound for another")
    step: float = setting(0.1, "s", "by which a window is then moved, halved twice",
        "finer costs time")
    shortest: float = setting(0.1, "s", "of a push", "shorter takes spikes for pushes",
        chosen="what a filter of 10 Hz makes of a hit")
    longest: float = setting(3.0, "s", "of a push", "longer takes drifts for pushes",
        chosen="above the 2 s of human pushes")
    pieces: int = setting(8, "", "constant stretches that a half sine is made of",
        "more cost time; fewer are less smooth")
    rests: float = setting(1.0, "s",
        "that a joint has to rest, for a hold, or to move on before a push that it alone felt",
        "longer misses short ones; shorter takes a reversal under load for a rest",
        chosen="longer than the slowest reversals last")
    breakaway: float = setting(2.0, "times",
        "its friction in motion, that a joint may hold at rest",
        "higher misses weak holds; lower takes stiction for a wall",
        chosen="friction as a joint breaks away is seldom more than 1.7 times that in motion")
    friction: float = setting(0.95, "quantile",
        "of torque beyond that of bodies in motion, that is a joint's friction",
        "higher takes pushes for friction; lower misses viscous one")
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
    joints: int = setting(2, "joints", "whose errors are as large at once",
        "more miss jolts; one takes the physics of a joint for one")
    apart: float = setting(0.5, "s", "between two jolts", "only wording")
    most: float = setting(0.03, "of the rows of motion",
        "that are jolts, without those to which the filter spreads them",
        "more leave out what recurs; fewer keep the jolts of a rough motion")


@settings
class IMPACTS:
    """Impacts as play is passed, which are neither pushes nor jolts (residuals.impacts)."""

    explained: float = setting(0.9, "of squared errors in and around an event",
        "that the acceleration of one joint alone explains",
        "higher takes impacts for pushes; lower takes pushes for impacts",
        chosen="of 11 impacts of concealed play it explains 0.83 to 1, most of them 0.96 and more; "
               "of 149 pushes added to recordings of three real arms half reach 0.32 as the load "
               "changes, 5 % 0.85, and none more than 0.91")
    alike: float = setting(0.8, "of squared errors in and around an event",
        "that it explains of further ones of a joint", "as above", chosen="as above")
    fewest: int = setting(2, "events", "of one joint that it explains",
        "more take impacts for pushes; one takes pushes for impacts by chance")
    joints: int = setting(3, "joints", "of an arm, at least",
        "more take impacts for pushes; of fewer, levers stand in such ratios often")
    fall: float = setting(1.5, "s", "before an event, in which the load of the joint changes",
        "longer takes pushes for impacts; shorter misses the slow fall across a wide play",
        chosen="1.3 s in a concealed gear whose play of 29 mrad is damped")


@settings
class ROUNDS:
    """Events and effects in turn (events), and other sets around one (reconsidering)."""

    several: int = setting(3, "effects",
        "of which one may stand for what two others make of one another",
        "fewer search again more often, which costs time")
