"""Settings of the selection: priors, and the search for sets of effects."""

from __future__ import annotations

from estimators.diagnosis.settings import setting, settings

# A table: value, unit, meaning; what it trades; how it was chosen.
# fmt: off


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
    deviating: float = setting(5.0, "nat", "that a wrong parameter has to bring", "as above",
        chosen="less, since everybody knows the parameter to be there")
    certain: float = setting(0.0, "nat",
        "that friction of a joint has to bring where none is stated",
        "higher lets rarer effects stand for it; there is nothing lower",
        chosen="every joint rubs: what is not known is how much")
    usual: float = setting(0.5, "of the joints",
        "more than which are stated to have an effect, so that it costs the others no more either",
        "higher names what is rare where plain friction is left out; lower prefers what few have")
    wrong: float = setting(1.0, "relative", "deviation of a parameter that is simply wrong",
        "smaller misses very wrong values; larger costs evidence")
    sharper: tuple[float, ...] = setting((0.1, 0.3, 3.0), "times the stated width",
        "over which dry friction that changes may turn its sign",
        "more cost time and chance; fewer leave friction to what happens to be as sharp",
        chosen=("2.1 N m that turn over 0.01 rad/s, beside 0.46 N m stated over 0.05, were called "
                "a coupling, which brought 405 nat where friction as stated brought 34"))
    wrong_inertia: float = setting(0.4, "relative", "the same of a body", "as above")
    parts_of_body: tuple[float, ...] = setting((1.0, 0.125), "of its 1 sigma",
        "that a body that is missing or wrong is expected to be",
        "more cost time and chance; fewer cost small bodies evidence",
        chosen="a load of 50 g cost 35 nat as one of 2 kg, and was called unknown")
    tiny: float = setting(1e-12, "", "strength below which a column is zero", "numerical")
    seldom: float = setting(0.1, "of the strongest", "of a list of places, that each counts as",
        "higher holds values where motion seldom is; lower lets them be anything there")
    together: int = setting(20, "hypotheses", "that pass the filter in one go",
        "more need memory; fewer cost time")
    payload: float = setting(0.08, "of the mass that moves", "1 sigma of the mass of a payload",
        "larger costs small payloads evidence; smaller large ones",
        chosen="2 kg on the iiwa 14; arms carry about as much in proportion, whatever their size")
    payload_lever: float = setting(0.08, "of the arm's length",
        "1 sigma of how far its centre of mass is from the flange", "as above",
        chosen="0.1 m on the iiwa 14")


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
class BASE_FRICTION:
    """Friction that a bare description lacks (selection.base_friction)."""

    turns: int = setting(2, "", "of noise and widths in turn",
        "more cost time; fewer do not settle")
    narrowest: float = setting(2.5e-4, "rad/s", "width of a sign that is tried",
        "narrower cannot be told from a step")
    widest: float = setting(8e-3, "rad/s", "width of a sign that is tried",
        "wider is viscous friction by another name")
    widths: int = setting(6, "", "that are tried, evenly in their logarithm", "more cost time")
