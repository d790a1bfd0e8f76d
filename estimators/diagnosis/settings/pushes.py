"""Settings: pushes from outside, which are events and no physics of the arm."""

from __future__ import annotations

from dataclasses import dataclass

from estimators.diagnosis.settings.setting import setting

# A table: value, unit, meaning; what it trades; how it was chosen.
# fmt: off


@dataclass(frozen=True)
class PushSettings:
    """The scan for pushes (contact)."""

    strongest: float = setting(100.0, "N or N m", "1 sigma of a wrench that is estimated",
        "larger leaves what is hardly seen free; smaller pulls strong pushes down")
    remembered: float = setting(4.0, "rows", "over which errors are alike",
        "more widen the intervals")
    most: int = setting(6, "", "beyond which none is named",
        "more name what recurs; fewer miss pushes")
    lengths: tuple[float, ...] = setting((0.4, 0.7, 1.2, 2.0), "s", "of the first scan",
        "more cost time; fewer miss some lengths", chosen="within the 0.3 to 2 s of human pushes")
    least_evidence: float = setting(25.0, "nat", "for a push against nothing",
        "higher misses weak pushes; lower finds some in noise")
    least_share: float = setting(0.35, "of what is strange about its rows",
        "that one wrench has to explain",
        "higher misses pushes beside other physics; lower takes other physics for pushes")
    alone: float = setting(8.0, "nat", "that one wrench has to be better than one joint alone",
        "higher misses pushes that one joint feels; lower takes friction for pushes")
    force: float = setting(20.0, "N", "1 sigma of a push",
        "larger costs weak pushes evidence; smaller strong ones")
    lever: float = setting(0.15, "m", "1 sigma of where it acts", "as above")
    torque: float = setting(5.0, "N m", "1 sigma of what could act on one joint alone",
        "larger makes one joint a weaker rival")
    moving: float = setting(0.8, "of a push", "in which a joint has to move to count",
        "higher counts fewer joints; lower counts those at rest")
    stride: float = setting(0.25, "of the length", "between windows of the first scan",
        "smaller costs time; larger misses pushes between")
    steps: tuple[float, ...] = setting((0.2, 0.1, 0.05, 0.02), "s",
        "by which a window is then moved", "finer costs time")
    shortest: float = setting(0.25, "s", "of a push", "shorter takes spikes for pushes",
        chosen="below the 0.3 s of human pushes")
    longest: float = setting(3.0, "s", "of a push", "longer takes drifts for pushes",
        chosen="above the 2 s of human pushes")
    pieces: int = setting(8, "", "constant stretches that a half sine is made of",
        "more cost time; fewer are less smooth")
    calm: float = setting(0.9, "quantile", "of the scan that stands for what is no push",
        "lower finds pushes where all is strange; higher misses some")
    spread: float = setting(0.3, "s", "over which the filter spreads a push",
        "longer leaves out motion; shorter fits what is pushed")


PUSHES = PushSettings()


@dataclass(frozen=True)
class RoundSettings:
    """Pushes and effects in turn (pipeline)."""

    several: int = setting(3, "effects",
        "of which one may stand for what two others make of one another",
        "fewer search again more often, which costs time")
    more: int = setting(2, "rounds", "of pushes and effects in turn",
        "more cost time; fewer leave one in the other")
    beyond_doubt: float = setting(100.0, "nat", "for a push",
        "higher misses weak pushes; lower leaves rows out for what is physics",
        chosen="far above other evidence, since an event cannot be proven on other rows")


ROUNDS = RoundSettings()
