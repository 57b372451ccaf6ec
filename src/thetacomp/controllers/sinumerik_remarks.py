"""What a person must know before the files are used: the same sentences for the console and for the sheet."""

from __future__ import annotations

from thetacomp.controllers.sinumerik import LeftOut, RegisterPlan
from thetacomp.model.document import components_of


def remarks(plan: RegisterPlan) -> tuple[str, ...]:
    """All remarks for the console: drift that does not agree, and errors that are not compensated."""
    worst = worst_drift(plan)
    drift = (f"DRIFT DOES NOT AGREE: {worst}",) if worst else ()
    return (*drift, *left_to_history(plan), *not_compensated(plan))


def left_to_history(plan: RegisterPlan) -> tuple[str, ...]:
    """What the law on key temperatures gives away against the model on heat history, held out."""
    worse = []
    used = components_of(plan.model.prediction)
    for name, component in plan.model.components.items():
        better = used.get(name)
        if better and better.held_out_um and component.held_out_um and better.held_out_um[0] < component.held_out_um[0]:
            worse.append(f"{name} {component.held_out_um[0]:.1f} instead of {better.held_out_um[0]:.1f} µm")
    if not plan.model.prediction:
        return ()
    rest = f" Held out it leaves (RMS): {', '.join(worse)}." if worse else ""
    return (f"the control carries the law on key temperatures; heat history needs filters that run next to it.{rest}",)


def differing(plan: RegisterPlan) -> tuple[LeftOut, ...]:
    """Intercepts left out that differ from the one in use by more than the 95 % bound; the worst first."""
    found = [one for one in plan.left_out if one.differs]
    return tuple(sorted(found, key=lambda one: -abs(one.difference_um)))


def worst_drift(plan: RegisterPlan) -> str:
    """The worst pair of intercepts that do not agree, and what this means; empty where all agree."""
    found = differing(plan)
    if not found:
        return ""
    worst = found[0]
    channel_axis = next(axis.channel_axis for axis in plan.axes if axis.drift_source == worst.counted)
    axis = worst.component[2:]
    seen = f"from the sweep along {axis}" if axis else "measured at a fixed position"
    more = f" {len(found) - 1} more such pairs are in part 6 of the sheet." if len(found) > 1 else ""
    return (
        f"K0[{channel_axis}] carries the intercept of {worst.counted}, {signed(worst.counted_um)} µm at the warmest"
        f" state, while {worst.component}, {seen}, has {signed(worst.intercept_um)} µm there (95 % bound of the"
        f" difference: ±{worst.bound_um:.0f} µm). Both should be the drift of the tool in {worst.direction}. Where"
        f" {worst.component} is right, the tool stands {abs(worst.difference_um):.0f} µm wrong with this K0. Find out"
        f" why before use; [drift_source] in export.toml makes the choice.{more}"
    )


def not_compensated(plan: RegisterPlan) -> tuple[str, ...]:
    """One sentence for every error of the model that no register carries, with its size."""
    return (
        *(
            f"not exported: {one.component}, up to {one.largest_um:.0f} µm at the warmest state, because no axis moves"
            f" along {one.direction}."
            for one in plan.not_exported
        ),
        *(
            f"no sensor predicts {name}: not compensated"
            f" (up to {plan.model.components[name].residual_um[1]:.0f} µm in the training states)."
            for name in plan.unpredicted
        ),
    )


def failed_checks(plan: RegisterPlan) -> str:
    """How many acceptance checks the model failed, as the head of their list; empty where none failed."""
    count = len(plan.model.failed_export_checks)
    return f"the model failed {count} acceptance check{'s' if count > 1 else ''}" if count else ""


def signed(value: float) -> str:
    """A whole number with its sign, with a true minus."""
    return f"{value:+.0f}".replace("-", "−")
