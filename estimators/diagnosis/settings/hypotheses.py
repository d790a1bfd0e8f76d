"""Settings: which lines a torque may have over its angle, and how far stated values move."""

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
    apart: float = setting(3.0, "resolutions", "between such a peak, if it is not the highest, and "
        "a line that was found",
        "larger misses neighbours of strong lines; smaller finds what those leave")
    neighbours: int = setting(61, "grid points",
        "whose median is the level that a line stands out from",
        "more blur a coloured level; fewer let a line raise its own")
    passed: float = setting(0.25, "", "gain of the filter below which a row does not count",
        "higher uses fewer rows; lower divides by nearly nothing")
    least_share: float = setting(0.25, "of the rows", "on which a line has to pass the filter",
        "more miss lines of fast joints; fewer judge by little",
        chosen="a tenth are those near reversals alone, where friction does all that it does")
    shape: int = setting(8, "knots", "of the dependence on position that is taken out first",
        "more take slow lines out; fewer leave shapes that look like lines")
    flat: int = setting(2, "knots", "the same, where a line of few periods is sought", "as above")
    few_periods: tuple[float, float] = setting((1.5, 6.0), "",
        "of such a line over the range of a joint",
        "wider finds shapes; narrower misses slow lines")
    least_part: float = setting(0.15, "of the residual's energy", "that such a line takes off",
        "lower finds shapes; higher misses weak lines")
    bulk: tuple[float, float] = setting((0.01, 0.99), "quantiles",
        "of the positions that are a joint's range",
        "wider counts where it hardly is; narrower leaves out ends at which it turns")
    around: int = setting(5, "grid points", "at which a line is sought around the one it is near",
        "more cost time; fewer leave a parabola too little")
    finer: int = setting(5, "times", "that this grid is then narrower, once", "as above")
    same: float = setting(0.05, "relative", "difference within which two lines are one",
        "larger merges neighbours; smaller counts one twice")
    sweeps: int = setting(3, "", "in which all lines are refined beside a new one, at most",
        "more cost time; fewer leave of a line what looks like another beside it",
        chosen="12 cycles of a motor came out as 11.85, and 7 as 7.06 and a false 6.56, without"
               " them; as 12.00 and 7.01 with them")
    stays: float = setting(0.01, "grid points", "by which a line moves that stays",
        "smaller costs time")
    dependent: float = setting(1e-6, "of a column", "that is but rounding", "numerical")
    block: int = setting(32, "frequencies", "at a time", "more need memory; fewer cost time")
    tiny: float = setting(1e-30, "", "that nothing is divided by less than", "numerical")
    burst: float = setting(6.0, "median deviations", "beyond which a residual is clipped",
        "more let a burst look like all lines; fewer clip lines")


@settings
class REVISION:
    """Steps in which a stated value moves (hypotheses.revision, improvement)."""

    step: float = setting(0.05, "relative", "of derivatives by a parameter",
        "larger is less linear; smaller loses digits")
    least_lever: float = setting(0.01, "m", "scale of a centre of mass that lies on an axis",
        "larger lets small bodies move far; smaller holds them")
    lever_step: float = setting(0.01, "of that lever", "of derivatives by a centre of mass",
        "numerical: inertia is quadratic in it")
    products: float = setting(0.3, "of the root of the product of two moments",
        "1 sigma of a product of inertia, before the tolerance of the body",
        "larger lets bodies tilt; smaller holds the axes that are stated")
    compact: float = setting(0.02, "m", "radius of a load whose extent the data do not tell",
        "larger adds inertia that nobody saw; smaller makes a point of it")
    narrower: float = setting(0.2, "times", "at least, in one revision",
        "smaller leaves what is linear; larger needs more rounds")
    wider: float = setting(5.0, "times", "at most, in one revision", "as above")
    stiffest: float = setting(0.01, "of an inverse", "that one revision leaves at least",
        "smaller makes gears stiff without bound; larger needs more rounds")
    steps: int = setting(9, "",
        "from the inertia that was found to the nominal one, of which the first that can be is "
        "taken", "more cost time; fewer go farther back than needed")
    shorter: int = setting(6, "halvings",
        "of a change after which no body that can be is where the arm is, until it is dropped",
        "more keep small parts of what cannot be; fewer drop more")
