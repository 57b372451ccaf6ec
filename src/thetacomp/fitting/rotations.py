"""The joint form in the stored document: its mark, the tool length that it holds for, and the thermal angles."""

from __future__ import annotations

from collections.abc import Sequence

from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.fitting.build import key_point_law, training_ranges
from thetacomp.fitting.key_point_law import AxisModel, fit_axis
from thetacomp.model.document import AxisLaw, Component, ModelDocument
from thetacomp.separation import Separated


def with_joint_form(
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
    rotations: dict[str, AxisLaw] = {}
    for states in axis_states(folder, separated.angles, train) if separated.angles else ():
        try:
            model = fit_axis(states, inputs.get(states.axis, ()))
        except AnalysisError:
            continue
        law = key_point_law(states, model, training_ranges(fitted), document.training.datum)
        rotations[states.axis] = law.model_copy(
            update={"components": {name: _as_angle(one) for name, one in law.components.items()}}
        )
    length_mm = folder.campaign(train[0]).settings.tool_length_mm
    return document.model_copy(update={"form": "joint", "tool_length_mm": length_mm, "rotations": rotations})


def _as_angle(component: Component) -> Component:
    return component.model_copy(update={"equation": component.equation.replace("[µm;", "[µrad;")})
