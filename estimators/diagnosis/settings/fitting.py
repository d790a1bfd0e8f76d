"""Settings of a fit: what competes and how it is searched, and when a fit is good enough."""

from __future__ import annotations

from estimators.diagnosis.settings import setting, settings

# A table: value, unit, meaning; what it trades; how it was chosen.
# fmt: off

@settings
class RIPPLE:
    """Lines over the angle of a joint (hypotheses.ripple)."""

    lines: int = setting(12, "", "at one joint, at most",
        "more cost time; fewer leave the cogging of a motor in part",
        chosen="a motor's pole pairs, slots and their multiples make eight and more; 3 left 40 % "
               "of the error of one with six")
    most_cycles: float = setting(400.0, "1/rev", "of a line",
        "more cost time and find more by chance; fewer miss fast gears")
    least_periods: float = setting(3.0, "", "of a line over the joint's range",
        "fewer take a shape for a line; more miss slow lines")
    false_lines: float = setting(1e-6, "lines", "expected in a scan of white noise",
        "more find lines that are none; fewer miss weak ones",
        chosen="far below 1, since no sensor's noise is quite so even")
    oversampling: float = setting(4.0, "grid points", "within the resolution of a line",
        "more cost time; fewer lose power between them")
    peaks: int = setting(4, "peaks", "that are tried for a line, one after the other",
        "more cost time; fewer stop at what lines not found yet leave",
        chosen="three of ten lines of a real motor were missed behind such a peak")
    neighbours: int = setting(61, "grid points",
        "whose median is the level that a line stands out from",
        "more blur a coloured level; fewer let a line raise its own")
    shape: int = setting(8, "knots", "of the dependence on position that is taken out first",
        "more take slow lines out; fewer leave shapes that look like lines")
    around: int = setting(5, "grid points",
        "at which a line is sought around one near it, and times that this grid is then narrower",
        "more cost time; fewer leave a parabola too little")
    block: int = setting(32, "frequencies", "at a time", "more need memory; fewer cost time")
    bulk: float = setting(0.01, "of the positions", "beyond either end of what is a joint's range",
        "wider counts where it hardly is; narrower leaves out ends at which it turns")
    least_part: float = setting(0.15, "of the residual's energy", "that such a line takes off",
        "lower finds shapes; higher misses weak lines")
    stays: float = setting(0.01, "grid points", "by which a line moves that stays",
        "smaller costs time")
    burst: float = setting(6.0, "median deviations", "beyond which a residual is clipped",
        "more let a burst look like all lines; fewer clip lines")


@settings
class REVISION:
    """Steps in which a stated value moves (hypotheses.revision, improvement)."""

    products: float = setting(0.3, "of the root of the product of two moments",
        "1 sigma of a product of inertia, before the tolerance of the body",
        "larger lets bodies tilt; smaller holds the axes that are stated")
    compact: float = setting(0.02, "m", "radius of a load whose extent the data do not tell",
        "larger adds inertia that nobody saw; smaller makes a point of it")
    wider: float = setting(5.0, "times", "at most, in one revision, and its inverse at least",
        "larger leaves what is linear; smaller needs more rounds")
    shorter: int = setting(6, "halvings",
        "of a change after which no body that can be is where the arm is, until it is dropped",
        "more keep small parts of what cannot be; fewer drop more")
    stiffest: float = setting(0.01, "of an inverse", "that one revision leaves at least",
        "smaller makes gears stiff without bound; larger needs more rounds")
    least_lever: float = setting(0.01, "m", "scale of a centre of mass that lies on an axis",
        "larger lets small bodies move far; smaller holds them")
    steps: int = setting(9, "",
        "from the inertia that was found to the nominal one, of which the first that can be is "
        "taken", "more cost time; fewer go farther back than needed")
    lever_step: float = setting(0.01, "of that lever", "of derivatives by a centre of mass",
        "numerical: inertia is quadratic in it")




@settings
class SEARCH:
    """The beam of sets (selection.search)."""

    width: int = setting(6, "sets", "that are grown further",
        "more cost time; fewer miss sets whose parts only help together")
    largest: int = setting(10, "effects", "in a set beyond its base",
        "more cost time; fewer cannot tell all of a real arm",
        chosen=("by judgement, changed once while developing on concealed cases: from 6, since a "
                "real arm lacks some at every joint"))


@settings
class CANDIDATES:
    """Priors of what competes (selection.candidates)."""

    missing: float = setting(10.0, "nat", "that missing physics has to bring",
        "higher misses small effects; lower gives false alarms",
        chosen=("by judgement, above the log of the some hundred effects at places that compete "
                "(4.6 nat)"))
    payload: float = setting(0.08, "of the mass that moves", "1 sigma of the mass of a payload",
        "larger costs small payloads evidence; smaller large ones",
        chosen="2 kg on the iiwa 14; arms carry about as much in proportion, whatever their size")
    wrong_inertia: float = setting(0.4, "relative", "the same of a body", "as above")
    sharper: tuple[float, ...] = setting((0.1, 0.3, 3.0), "times the stated width",
        "over which dry friction that changes may turn its sign",
        "more cost time and chance; fewer leave friction to what happens to be as sharp",
        chosen=("2.1 N m that turn over 0.01 rad/s, beside 0.46 N m stated over 0.05, were called "
                "a coupling, which brought 405 nat where friction as stated brought 34"))
    parts_of_body: tuple[float, ...] = setting((1.0, 0.125), "of its 1 sigma",
        "that a body that is missing or wrong is expected to be",
        "more cost time and chance; fewer cost small bodies evidence",
        chosen="a load of 50 g cost 35 nat as one of 2 kg, and was called unknown")


@settings
class TOLERATED:
    """Nuisance parameters: values that may differ within their tolerances (selection.nuisance)."""

    sensor_lag: float = setting(3e-4, "s",
        "1 sigma of a torque sensor's filter against the encoder's",
        "larger hides delays; smaller finds delays that are the sensor")
    sensor_offset: float = setting(0.3, "noise floors", "1 sigma of the offset of a torque sensor",
        "larger hides offsets; smaller finds offsets that are the sensor")
    width: float = setting(0.7, "relative", "1 sigma of the width of a smoothed sign",
        "larger hides friction laws; smaller takes widths for physics")


@settings
class SOLVING:
    """Noise and search in turn (fitting.solving)."""

    rounds: int = setting(2, "", "of noise and search in turn",
        "more cost time; fewer search under a noise that has physics in it")
    unbound: float = setting(10.0, "times the tolerance",
        "that a value at its limit is given, to see where data put it",
        "higher lets what little the motion shows be anywhere; lower draws it back")
    linearisation_is_poor: float = setting(0.4, "of the remaining residual",
        "by which a simulation may be off its linear fit",
        "higher keeps fits that are not what is simulated; lower searches again too often")


@settings
class LATENESS:
    """Torque that is late as a whole (fitting.lateness)."""

    shortest: float = setting(0.005, "s", "of a lag or delay that is tried, and doubled up to",
        "shorter costs time; longer starts far from the true one")
    step: float = setting(0.08, "s", "from which on they are this far apart",
        "longer starts far from the true one; shorter costs time",
        chosen="a quarter of a period of motion of 3 Hz")
    longest: float = setting(0.48, "s", "of them", "longer costs time; shorter misses long ones",
        chosen="as filters of reported currents are, which reach 0.5 s")
    long: float = setting(0.1, "s", "of a lag and a delay that compete from the start",
        "longer misses those of some hundredths of a second; shorter those of some tenths",
        chosen="75 and 90 ms, hidden in a real recording, were taken for friction without")


@settings
class NEWTON:
    """Gauss-Newton of all that was found (fitting.linearised)."""

    rounds: int = setting(5, "", "at most", "more cost time; fewer stop short")
    shorter: int = setting(2, "halvings", "of a step, that are tried",
        "more cost time; fewer give up where a full step is too far")
    block: float = setting(2.0, "s", "over which scores are summed for intervals",
        "longer leaves few blocks; shorter takes errors for independent")
    slack: float = setting(1.02, "times", "that a round may raise a joint's RMSE, at most",
        "higher lets errors grow that are alike in time; lower stops at noise")


@settings
class CONTRIBUTION:
    """Error that a finding has to remove (fitting.contribution)."""

    material: float = setting(0.5, "errors left",
        "that a finding has to take off the error of some joint",
        "higher names less; lower names what hardly matters")
    most: float = setting(0.6, "of the evidence for a finding",
        "that a simpler one in its place has to bring",
        "higher keeps laws with many parameters; lower gives names to what only resembles")
    tellable: float = setting(4.0, "nat", "within which explanations are indistinguishable",
        "higher lists more equivalents; lower is sure too soon")
    relieved: int = setting(4, "stated values",
        "more at the limit of their tolerances without a finding that is to be believed for that",
        "lower names what one wrong statement feigns; higher misses small bodies in short motion",
        chosen="of values that are off as stated, that many are so once in ten million arms")
    felt: float = setting(0.2, "errors left",
        "that friction takes off them at least, of a law that merely fits better",
        "higher leaves laws to what is plainer; lower has friction where a torque has none",
        chosen="2 % of what is left; 0.001 N m of chance beside a noise of 0.02 took off 0.1")


@settings
class REFINEMENT:
    """Settings that the torque is not linear in (fitting.refinement)."""

    evaluations: int = setting(60, "", "of the evidence, at most",
        "more cost time; fewer stop short")
    rejected: float = setting(1e6, "", "objective where no column comes out",
        "numerical: worse than any")
    tolerance: float = setting(3e-3, "of the range of a setting",
        "within which all that is tried lies once it stops",
        "smaller costs time; larger stops short")
    inside: float = setting(0.02, "of the range of a setting",
        "from either of its ends, that the search begins at least",
        "larger begins farther from what was tried; smaller leaves a first step no room")


@settings
class LAWS:
    """Laws of one effect (fitting.laws)."""

    carried: float = setting(0.02, "of the friction of all springs",
        "that one of the grid has to carry, to be among these",
        "lower refines shares of noise; higher loses the last width")
    refinable: float = setting(100.0, "nat",
        "that a refinement may make up for, where no law has a name",
        "higher costs time; lower leaves out what would have been best")
