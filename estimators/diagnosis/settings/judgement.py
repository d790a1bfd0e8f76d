"""Settings of the judgement: findings, their confidence, and what stays unknown."""

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

    widths: tuple[float, ...] = setting((3e-4, 1e-3, 4e-3, 0.015, 0.06), "rad", "of its stops",
        "more cost time and fit noise; fewer see less")
    speeds: tuple[float, ...] = setting((0.002, 0.01, 0.04, 0.15), "rad/s", "of its signs",
        "as above")
    ridges: tuple[float, ...] = setting((1e-3, 1e-2, 1e-1, 1.0), "of the mean energy of a feature",
        "of which the best is taken", "only bounds: the rows left out choose")
    block: float = setting(3.0, "s", "of a stretch that is left out whole, at most",
        "longer leaves few; shorter lets errors that are alike predict one another")
    folds: int = setting(5, "", "of time, each left out once",
        "more cost time; fewer train on less")
    waves: tuple[float, ...] = setting((1.0, 2.0, 3.0), "per revolution",
        "of its dependence on position", "more fit noise; fewer see less")
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

    affected: float = setting(1.15, "noise floors", "of error, from which a joint is looked into",
        "lower asks of noise; higher asks seldom")
    least_evidence: float = setting(6.0, "nat", "for a yes",
        "higher says no to weak dependence; lower yes to chance")
    least_share: float = setting(0.05, "of the reducible error held out", "for a yes", "as above")
    distances: tuple[float, ...] = setting((1e-3, 6e-3, 0.03, 0.15), "rad",
        "over which friction may build up", "more cost time; fewer see less")
    speeds: tuple[float, ...] = setting((0.01, 0.05), "rad/s", "over which friction may fade",
        "as above")
    sharp: float = setting(0.002, "rad/s", "over which the sign of motion turns",
        "wider is viscous friction; narrower a step at reversals")
    hats: int = setting(5, "", "of a smooth dependence", "more fit noise; fewer see less")
    least_reducible: float = setting(0.1, "of the floor", "that shares are taken of at least",
        "lower gives shares of noise; higher understates")


@settings
class REGION:
    """Region in which a finding acts (judgement.region)."""

    narrow: float = setting(0.5, "ratio of medians", "below which a region is worth a word",
        "only wording")
    wide: float = setting(2.0, "ratio of medians", "above which it is", "only wording")
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

    price: float = setting(10.0, "nat", "that an effect would have to bring", "lower lists less",
        chosen="as for missing physics")
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
    times: tuple[float, ...] = setting((0.5, 2.0), "times a guessed tolerance", "that are tried",
        "more cost time; fewer say less of what a guess decides")
    listed: int = setting(3, "effects", "that another tolerance would bring, named", "only wording")
