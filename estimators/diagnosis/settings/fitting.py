"""Settings: when a fit is good enough, and when something else is tried."""

from __future__ import annotations

from estimators.diagnosis.settings import setting, settings

# A table: value, unit, meaning; what it trades; how it was chosen.
# fmt: off


@settings
class SOLVING:
    """Noise and search in turn (fitting.solving)."""

    least_left: float = setting(0.05, "of the errors' mean square",
        "that a fit of everything is taken to leave, at least",
        "higher underrates the errors of short recordings; lower divides by nearly nothing")
    rounds: int = setting(2, "", "of noise and search in turn",
        "more cost time; fewer search under a noise that has physics in it")
    followed: float = setting(2.0, "times the error of the linear fit",
        "that a simulation may have, where that is more than the given one's",
        "higher keeps what no simulation can follow; lower drops what a search around it mends")
    blamed: float = setting(0.5, "of the squared deviation of a simulation from its linear fit",
        "that goes with a member which may be to blame",
        "higher blames what feeds a runaway; lower what only adds to it")
    unbound: float = setting(10.0, "times the tolerance",
        "that a value at its limit is given, to see where data put it",
        "higher lets what little the motion shows be anywhere; lower draws it back")
    surely: float = setting(3.0, "standard errors", "by which data put a value beyond its limit",
        "higher misses values just beyond; lower doubts what is badly known")
    linearisation_is_poor: float = setting(0.4, "of the remaining residual",
        "by which a simulation may be off its linear fit",
        "higher keeps fits that are not what is simulated; lower searches again too often")


@settings
class LATENESS:
    """Torque that is late as a whole (fitting.lateness)."""

    times: tuple[float, ...] = setting(
        (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.24, 0.32, 0.4, 0.48), "s",
        "of a lag or delay that are tried",
        "more cost time; fewer start far from the true one",
        chosen="to 0.5 s, as filters of reported currents are, a factor of two apart, and by a "
               "quarter of a period of motion of 3 Hz")
    long: float = setting(0.1, "s", "of a lag and a delay that compete from the start",
        "longer misses those of some hundredths of a second; shorter those of some tenths",
        chosen="75 and 90 ms, hidden in a real recording, were taken for friction without")
    asked: int = setting(2, "", "of these that a longer one may do without",
        "more cost time; fewer miss what begins to help late")


@settings
class NEWTON:
    """Gauss-Newton of all that was found (fitting.linearised)."""

    block: float = setting(2.0, "s", "over which scores are summed for intervals",
        "longer leaves few blocks; shorter takes errors for independent")
    rounds: int = setting(5, "", "at most", "more cost time; fewer stop short")
    enough: float = setting(1e-3, "of the sum of squares", "that a round has to take off",
        "smaller costs time; larger stops short")
    slack: float = setting(1.02, "times", "that a round may raise a joint's RMSE, at most",
        "higher lets errors grow that are alike in time; lower stops at noise")
    shorter: tuple[float, ...] = setting((1.0, 0.5, 0.2), "of a step", "that are tried",
        "more cost time; fewer give up where a full step is too far")
    derivative: float = setting(1e-3, "prior deviations", "step of derivatives",
        "larger is less linear; smaller loses digits")
    disagree: float = setting(0.95, "of a chi-square distribution",
        "that joints have to disagree beyond before intervals of what loads them all widen",
        "higher trusts joints that disagree; lower widens intervals by chance")


@settings
class CONTRIBUTION:
    """Error that a finding has to remove (fitting.contribution)."""

    material: float = setting(0.5, "errors left",
        "that a finding has to take off the error of some joint",
        "higher names less; lower names what hardly matters")
    felt: float = setting(0.2, "errors left",
        "that friction takes off them at least, of a law that merely fits better",
        "higher leaves laws to what is plainer; lower has friction where a torque has none",
        chosen="2 % of what is left; 0.001 N m of chance beside a noise of 0.02 took off 0.1")
    most: float = setting(0.6, "of the evidence for a finding",
        "that a simpler one in its place has to bring",
        "higher keeps laws with many parameters; lower gives names to what only resembles")
    tellable: float = setting(4.0, "nat", "within which explanations are indistinguishable",
        "higher lists more equivalents; lower is sure too soon")
    seen: float = setting(0.5, "of an effect's mean square",
        "that rows held out have to have to judge it",
        "lower judges by rows that lack the effect; higher judges by rows that were fitted")
    relieved: int = setting(4, "stated values",
        "more at the limit of their tolerances without a finding that is to be believed for that",
        "lower names what one wrong statement feigns; higher misses small bodies in short motion",
        chosen="of values that are off as stated, that many are so once in ten million arms")
    slight: float = setting(0.1, "of what is gained over all rows",
        "that may be lost on those held out",
        "higher keeps what does not carry over; lower drops rare events")


@settings
class LAWS:
    """Laws of one effect (fitting.laws)."""

    refinable: float = setting(100.0, "nat",
        "that a refinement may make up for, where no law has a name",
        "higher costs time; lower leaves out what would have been best")
    resembling: float = setting(0.6, "of the evidence for a finding",
        "that what is confused with it has to bring as it is tried, to be refined beside it",
        "lower costs time; higher gives a name to what lies better on the grid",
        chosen=("play of 0.7 mrad brought 0.75 of it on the grid of gaps, and 1.3 once refined; "
                "a gap between two that are tried has 0.63 in common with the nearer one"))


@settings
class REFINEMENT:
    """Settings that the torque is not linear in (fitting.refinement)."""

    evaluations: int = setting(60, "", "of the evidence, at most",
        "more cost time; fewer stop short")
    inside: float = setting(0.02, "of the range of a setting",
        "from either of its ends, that the search begins at least",
        "larger begins farther from what was tried; smaller leaves a first step no room")
    step: float = setting(0.1, "of the range of a setting", "that is tried first",
        "larger leaves the valley it began in; smaller costs time")
    tolerance: float = setting(3e-3, "of the range of a setting",
        "within which all that is tried lies once it stops",
        "smaller costs time; larger stops short")
    gained: float = setting(0.05, "nat", "by which it differs then", "as above")
    rejected: float = setting(1e6, "", "objective where no column comes out",
        "numerical: worse than any")
