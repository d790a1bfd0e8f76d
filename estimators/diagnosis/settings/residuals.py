"""Settings: what counts as a row, as noise, as a repeat and as a mistake of the log."""

from __future__ import annotations

from estimators.diagnosis.settings import setting, settings

# A table: value, unit, meaning; what it trades; how it was chosen.
# fmt: off


@settings
class ROWS:
    """Rows of recordings that count (residuals.observations)."""

    per_bandwidth: float = setting(2.5, "rows/(s Hz)", "rows of the slow grid",
        "more cost time; fewer than 2 lose information",
        chosen="a little above the sampling theorem")
    samples_per_bandwidth: float = setting(20.0, "samples/(s Hz)",
        "samples kept of fast recordings",
        "more cost time and say nothing that passes the filters; fewer blur what is sharp before "
        "it is filtered")
    least: int = setting(60, "rows", "of all recordings together, on the slow grid",
        "more refuse short recordings; fewer judge by little",
        chosen="what a joint's friction and load need by themselves; 200 refused logs of 6 s")
    rest: float = setting(0.75, "widths of the stated friction's sign",
        "speed below which a joint is at rest",
        "higher leaves out slow motion; lower fits friction that holds anything",
        chosen=("by judgement, changed once while developing on concealed cases: 1.5 sign widths "
                "were tried and taken back, since they left creep out of fits too"))
    dwell: float = setting(5.0, "1/bandwidth", "of such slow motion that is a rest",
        "longer fits friction that holds anything; shorter leaves out reversals, and presliding",
        chosen="presliding of two real arms was lost where such reversals were left out")
    travel: float = setting(0.05, "rad",
        "of a joint that counts as moving, or m of one that slides",
        "more leaves out small motion; less asks joints at rest")
    difference: float = setting(1e-4, "rad", "step of derivatives of the rigid body",
        "larger is less exact; smaller loses digits")
    even: float = setting(1e-4, "sample periods",
        "deviation from an even grid that does not matter",
        "larger skips resampling that would be needed; smaller resamples for rounding")


@settings
class NOISE:
    """Errors that are alike in time (residuals.noise)."""

    order: int = setting(3, "rows", "before, from which an error is predicted",
        "more fits noise; fewer leaves errors alike, which look like physics")
    strongest: float = setting(0.97, "", "reflection, at most",
        "higher remembers longer and takes slow physics for noise; lower whitens less",
        chosen="so that errors forget within some fifty rows")
    least: float = setting(2e-6, "of the torque of the strongest joint", "deviation of any noise",
        "larger hides what exact torques show; smaller takes rounding for physics",
        chosen="below any torque sensor: 0.1 mN m on an arm whose shoulder holds 50 N m")


@settings
class HELD_OUT:
    """Motion that nothing is fitted to (residuals.held_out)."""

    blocks: int = setting(8, "", "of each recording, in time",
        "more are shorter and nearer to what is fitted; fewer hold out other motion")
    which: tuple[int, ...] = setting((2, 5), "", "blocks held out, from 0",
        "more leave less to fit to",
        chosen="in the middle, so that effects that change with time are not extrapolated")
    resamples: int = setting(400, "", "of the interval of the error removed",
        "more cost time; fewer are a rough interval")
    block: float = setting(3.0, "s", "of a stretch that is resampled whole",
        "longer leaves few stretches; shorter takes errors for independent",
        chosen="longer than errors remember")
    guard: float = setting(1.0, "s", "between rows fitted and rows held out, at most",
        "longer leaves less; shorter proves what is remembered, not what is predicted")
    guard_part: float = setting(0.03, "of a recording", "that such a guard takes, at most",
        "more leaves a short recording little to fit to; less brings its blocks close",
        chosen="so that four guards take an eighth of a recording; 1 s left 18 % of 6 s to fit to")


@settings
class ELSEWHERE:
    """Motion of another kind, that proves what may be written (judgement.writing)."""

    turns: int = setting(4, "", "in which it is left out, as a part of all each",
        "more leave out motion that is more alike to what is fitted, and take time",
        chosen="fast, slow, and either end of the poses; recordings alike")
    share: float = setting(0.02, "of the rows that count",
        "that a part has to act on, as an effective number, to be written",
        "higher leaves out what acts but at reversals; lower writes what one place has shown",
        chosen="by judgement: half a second of half a minute")


@settings
class REPEATS:
    """Motion recorded again (residuals.repeats)."""

    near: float = setting(0.02, "rad", "RMS by which their positions may differ",
        "larger pairs other motion; smaller misses repeats")


@settings
class PLAUSIBILITY:
    """Torques that cannot be of that motion (residuals.plausibility)."""

    scale: float = setting(12.0, "times", "a sensor may be off",
        "higher lets wrong units of one joint pass; lower refuses wrong gains")
    scale_of_all: float = setting(4.0, "times", "all sensors together may be off",
        "higher lets wrong units pass; lower refuses wrong masses")
    beyond_friction: float = setting(0.01, "of the square of a simulated torque",
        "that is no friction, from which its scale is judged",
        "higher lets wrong units of joints that mostly rub pass; lower refuses unknown friction")


@settings
class MISTAKES:
    """Mistakes of a log that are tried (residuals.mistakes)."""

    least_moving: int = setting(20, "rows", "on which a joint has to move to be judged",
        "more judge seldom; fewer judge by little")
    rows: int = setting(1500, "", "that are enough to judge by", "more cost time")
    rows_to_turn: int = setting(400, "", "the same, where all angles of a joint are tried",
        "more cost time")
    angles: int = setting(120, "", "of a joint that are tried, over a turn",
        "more cost time; fewer miss the zero")


@settings
class MOUNTING:
    """An arm whose base is turned far (residuals.mounting)."""

    least: float = setting(15.0, "degrees", "that its base is turned by",
        "higher leaves large tilts to effects that are linear in them; lower takes a wrong body "
        "for a tilt")
    square: float = setting(4.0, "degrees", "from an axis of the base that are none",
        "higher takes tilts for walls; lower takes what a fit is off by for a tilt")
    alike: float = setting(30.0, "rows", "whose errors are one independent error",
        "more judge fewer arms; fewer are surer than they may be")


@settings
class SWINGS:
    """Errors that swing (judgement.surrogate), where a link does on its spring."""

    rows: int = setting(40, "rows", "of a block, in which a frequency is about constant",
        "more average over poses; fewer take noise for a swing")
    blocks: int = setting(8, "", "of a joint that moves, at least",
        "more judge no short recording; fewer judge by chance")
    predicted: float = setting(1.6, "times what is left",
        "that errors are once they are predicted from those before",
        "higher overlooks swings; lower takes noise behind the filter for one",
        chosen=("1.2 to 1.5 of what 56 other concealed cases leave, one of 1.6; 1.9 to 4.2 at some "
                "joint of ten elastic ones"))


@settings
class ABOVE:
    """Errors above the bandwidth (residuals.above_bandwidth)."""

    share: float = setting(0.5, "of a joint's squared errors",
        "above the bandwidth, if that is said", "only wording")
    outstanding: float = setting(10.0, "times the median density of power",
        "above which a frequency stands out of noise",
        "higher misses broad bands; lower takes noise for a band")
    most: float = setting(0.9, "of the power that stands out",
        "that lies below the end of a band", "only wording")
    window: float = setting(2.0, "s", "of a spectrum",
        "longer tells frequencies finer, and noisier")
