"""Whether a model document holds together, and whether a machine can be like that. Asked once, where it is read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from thetacomp.model.band import Band
from thetacomp.model.border import Border
from thetacomp.model.document import AxisLaw, Component, Fallback, ModelDocument, Reference, Term
from thetacomp.model.fallback import without_sensor
from thetacomp.model.filters import InputLayout
from thetacomp.model.leverage import Leverage

# 100 mm, or 10 % of a length, for one unit of an input: far beyond any machine, near enough to keep sums finite.
LARGEST_UM = 1e5
COLDEST_DEGC, HOTTEST_DEGC = -60.0, 250.0
LONGEST_MM = 1e6
SMALLEST = 1e-15
TERMS = ("intercept", "slope", "bend")


def problems(model: ModelDocument) -> list[str]:
    """What is wrong with a document, each with its place; empty for one that can be used."""
    axes = {axis.name: axis for axis in model.axes}
    out = [f"axes: {name} is named twice" for name in axes if sum(a.name == name for a in model.axes) > 1]
    for axis in model.axes:
        if max(map(abs, axis.travel_mm)) > LONGEST_MM:
            out.append(f"axes.{axis.name}: a travel beyond {LONGEST_MM / 1e6:g} km")
    if abs(model.tool_length_mm) > LONGEST_MM:
        out.append(f"tool_length_mm: {model.tool_length_mm:g} mm is no tool")
    if model.form == "joint" and "" not in model.in_use:
        out.append("the joint form has no drift (DX, DY, DZ)")
    for room in ("control", "prediction", "rotations"):
        laws: Mapping[str, AxisLaw] = getattr(model, room)
        for name, law in laws.items():
            place = f"{room}.{name or 'drift'}"
            if law.axis != name:
                out.append(f"{place}: it is the law of axis {law.axis}")
            if name and name not in axes:
                out.append(f"{place}: the axis {name} is not among the axes of the model")
            if room != "prediction" and law.layout.time_constants_s:
                out.append(f"{place}: its inputs are not plain temperatures")
            out += [f"{place}: {problem}" for problem in _law(law, angles=room == "rotations")]
    return out


def _law(law: AxisLaw, *, angles: bool) -> list[str]:
    """What is wrong with a law, and with its fallbacks where the law itself is right: they are parts of it."""
    found = list(_own(law, angles=angles))
    if not found:
        for fallback in law.fallbacks:
            found += [f"fallback for {fallback.lost}: {problem}" for problem in _fallback(fallback, law, angles)]
    return found


def _own(law: AxisLaw, *, angles: bool) -> Iterator[str]:
    yield from _travel(law)
    inputs, sensors = sum(len(block) for block in law.layout.blocks.values()), len(law.layout.sensors)
    yield from _layout(law.layout)
    yield from _reference(law.reference, law.layout.running, sensors)
    yield from _leverage("leverage", law.leverage, inputs)
    yield from _border(law.border, law.layout.sensors, inputs)
    letters = dict(zip("XYZ", "ABC" if angles else "XYZ", strict=True))
    for name, component in law.components.items():
        expected = f"D{name[1:]}" if not law.axis else f"E{name[1:2]}{law.axis}"
        if name != expected or name[1:2] != letters[component.direction]:
            yield f"{name}: the name does not fit direction {component.direction} and axis {law.axis or 'none'}"
        yield from (f"{name}: {problem}" for problem in _component(component, law, inputs, sensors))
    names = [component.direction for component in law.components.values()]
    if not names or len(set(names)) < len(names):
        yield "no component, or two of one direction"


def _travel(law: AxisLaw) -> Iterator[str]:
    positions = (law.p0_mm, law.p_min_mm, law.p_max_mm)
    if not law.axis:
        if positions != (None, None, None):
            yield "positions of a drift"
    elif law.p0_mm is None or law.p_min_mm is None or law.p_max_mm is None:
        yield "an axis without a slope, P0 or range of positions"
    elif not law.p_min_mm < law.p_max_mm:
        yield f"the measured travel from {law.p_min_mm:g} to {law.p_max_mm:g} mm has no length"
    elif max(abs(law.p0_mm), abs(law.p_min_mm), abs(law.p_max_mm)) > LONGEST_MM:
        yield f"a position beyond {LONGEST_MM / 1e6:g} km"


def _layout(layout: InputLayout) -> Iterator[str]:
    if len(set(layout.sensors)) < len(layout.sensors):
        yield "layout: a sensor is listed twice"
    if layout.time_constants_s and not layout.sensors:
        yield "layout: filters without a sensor"
    if not all(1e-3 <= tau_s <= 1e9 for tau_s in layout.time_constants_s):
        yield "layout: a time constant that no machine has"
    if not all(1 <= power <= 4 for power in layout.speed_powers) or len(set(layout.speed_powers)) < len(
        layout.speed_powers
    ):
        yield f"layout: speed_powers are {layout.speed_powers}, expected different ones of 1 to 4"
    if layout.products and (not layout.time_constants_s or len(set(layout.products)) < len(layout.products)):
        yield "layout: products twice, or without filters"
    yield from _plausible("layout.base_degC", (layout.base_degC,))


def _reference(reference: Reference, running: int, sensors: int) -> Iterator[str]:
    if len(reference.inputs) != running:
        yield f"the layout has {running} running inputs, the reference has {len(reference.inputs)}"
    yield from _plausible("reference", reference.inputs[:sensors])


def _plausible(what: str, values_degC: Sequence[float]) -> Iterator[str]:
    for value in values_degC:
        if not COLDEST_DEGC <= value <= HOTTEST_DEGC:
            yield f"{what}: {value:g} °C is no temperature of a machine ({COLDEST_DEGC:g} to {HOTTEST_DEGC:g})"


def _leverage(what: str, leverage: Leverage, inputs: int) -> Iterator[str]:
    if {len(leverage.centre), len(leverage.scale), *map(len, leverage.directions)} != {inputs}:
        yield f"{what}: not one of {inputs} inputs"
    if len(leverage.moments) != len(leverage.directions):
        yield f"{what}: {len(leverage.moments)} moments for {len(leverage.directions)} directions"
    if any(scale != 0 and scale < SMALLEST for scale in leverage.scale):
        yield f"{what}: a scale below zero"
    if leverage.floor is not None and leverage.floor < SMALLEST:
        yield f"{what}: a floor that is not above zero"
    if leverage.at_centre < 0 or any(moment < (0 if leverage.floor else SMALLEST) for moment in leverage.moments):
        yield f"{what}: a variance below zero"


def _border(border: Border, sensors: Sequence[str], inputs: int) -> Iterator[str]:
    for what, ranges in (("temperature_degC", border.temperature_degC), ("rise_K", border.rise_K)):
        for sensor, (low, high) in ranges.items():
            if not low <= high:
                yield f"border.{what}: {sensor} from {low:g} to {high:g}"
            yield from _plausible(f"border.{what} of {sensor}", (low, high)) if what == "temperature_degC" else ()
        if ranges and (lacking := [s for s in sensors if s not in ranges]):
            yield f"border.{what}: no training range for {', '.join(lacking)}"
    validity = border.distance
    if validity is None:
        if sensors and not border.temperature_degC:
            yield "border: neither a box of temperatures nor a distance"
        return
    if {len(validity.middle), len(validity.half_span)} != {inputs + len(sensors)}:
        yield f"the border of validity is not one of {inputs + len(sensors)} inputs"
    if min(validity.leverage_unit, validity.range_unit, validity.limit) < SMALLEST:
        yield "border.distance: a unit or limit that is not above zero"
    if any(span != 0 and span < SMALLEST for span in validity.half_span):
        yield "border.distance: a half span below zero"
    yield from _leverage("border.distance.leverage", validity.leverage, inputs + len(sensors))


def _component(component: Component, law: AxisLaw, inputs: int, sensors: int) -> Iterator[str]:
    if not law.axis and len(component.terms) > 1:
        yield "a slope without an axis"
    if law.axis and len(component.terms) < 2:
        yield "an axis without a slope, P0 or range of positions"
    for label, term in zip(TERMS, component.terms, strict=False):
        yield from _term(label, term, inputs, sensors, fades=law.border.distance is not None)
    if len({bool(term.coefficients) for term in component.terms}) > 1:
        yield "some of its terms have no coefficients"
    if component.leverage is not None:
        yield from _leverage("leverage", component.leverage, inputs)
    yield from _band(component.band, len(component.terms))


def _term(label: str, term: Term, inputs: int, sensors: int, *, fades: bool) -> Iterator[str]:
    if len(term.coefficients) != inputs and (term.coefficients or fades):
        yield f"{label} has {len(term.coefficients)} coefficients for {inputs} inputs"
    if term.beyond is not None and len(term.beyond) != sensors:
        yield f"prior of the {label} has {len(term.beyond)} coefficients for {sensors} inputs"
    if (term.beyond is not None) != fades:
        yield f"the {label} and its prior do not come together" if fades else f"prior of the {label} without a border"
    for value in (term.constant, *term.coefficients, *(term.beyond or ())):
        if not abs(value) <= LARGEST_UM:
            yield f"{label}: {value:.3g} is an error that no machine has (at most {LARGEST_UM:g})"


def _band(band: Band, terms: int) -> Iterator[str]:
    if not 1 <= len(band.sd) <= terms:
        yield f"band: {len(band.sd)} standard deviations for {terms} terms"
    if min((*band.sd, band.growth, band.noise_sd_um)) < 0 or abs(band.correlation) > 1.0 + 1e-9:
        yield "band: a variance below zero"
    largest = max((*band.sd, band.noise_sd_um))
    if largest > LARGEST_UM:
        yield f"band: {largest:.3g} is a scatter that no machine has"
    if min(band.knee, band.far, 1.0 if band.quantile is None else band.quantile) < SMALLEST:
        yield "band: a quantile, knee or far that is not above zero"


def _fallback(fallback: Fallback, law: AxisLaw, angles: bool) -> Iterator[str]:
    if fallback.lost not in law.layout.sensors or fallback.lost in fallback.layout.sensors:
        yield "it is not a law without a sensor of the axis"
    elif not fallback.components.keys() == fallback.accuracy.keys() == law.components.keys():
        yield "its components are not those of the axis"
    elif (fallback.leverage is None or fallback.border is None) and not (
        set(fallback.layout.sensors) < set(law.layout.sensors)
        and fallback.layout.time_constants_s == law.layout.time_constants_s
        and fallback.layout.speed_powers == law.layout.speed_powers
    ):
        yield "no leverage or border, and its inputs are not those that are left"
    else:
        yield from _law(without_sensor(law, fallback), angles=angles)
