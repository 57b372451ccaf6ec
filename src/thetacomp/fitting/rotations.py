"""The joint form in the stored document: its mark, the tool length that it holds for, and the thermal angles."""

from __future__ import annotations

from collections.abc import Sequence

from thetacomp.arrays import CARTESIAN
from thetacomp.campaign import MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.fitting.build import component_of
from thetacomp.fitting.key_point_law import AxisModel, fit_axis
from thetacomp.model.document import Component, ModelDocument
from thetacomp.separation import Separated
from thetacomp.states import AxisStates, axis_states

ABOUT = dict(zip("ABC", CARTESIAN, strict=True))


def with_form(
    document: ModelDocument,
    folder: MachineFolder,
    separated: Separated,
    fitted: Sequence[tuple[AxisStates, AxisModel]],
    train: Sequence[str],
) -> ModelDocument:
    """The document with its form; in the joint form with the angles, fitted on the key points of their axis.

    Angles have no key points of their own: heat that turns an axis also bends what it carries. They are not validated
    on their own.
    """
    if separated.form == "separate":
        return document
    inputs = {states.axis: model.inputs for states, model in fitted}
    rotations: dict[str, Component] = {}
    for states in axis_states(folder, separated.angles, train) if separated.angles else ():
        try:
            model = fit_axis(states, inputs.get(states.axis, ()))
        except AnalysisError:
            continue
        for k, name in enumerate(states.components):
            rotations[name] = _as_angle(component_of(states, model, k, ABOUT[name[1]]))
    length_mm = folder.campaign(train[0]).settings.tool_length_mm
    return document.model_copy(update={"form": "joint", "tool_length_mm": length_mm, "rotations": rotations})


def _as_angle(component: Component) -> Component:
    equation = component.equation.replace("[µm;", "[µrad;")
    return component.model_copy(update={"equation": equation})
