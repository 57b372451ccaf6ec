"""Folds, baselines, column deviation, permutation and acceptance on states whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from thetacomp.analysis import analyze_folder
from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import Campaign, CampaignSettings, MachineFolder, Parameters
from thetacomp.errors import AnalysisError
from thetacomp.fitting.key_point_law import all_sensors, clock, fit_axis, training_mean
from thetacomp.fitting.procedures import key_point_procedure
from thetacomp.folds import forward_in_time, hold_out
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.model.temperatures import Temperatures
from thetacomp.separation import separate_folder
from thetacomp.validation.acceptance import fit_for_use
from thetacomp.validation.outcome import ValidationRow
from thetacomp.validation.permutation import permutation_test

MACHINE = Machine(
    name="linear",
    axes=(Axis(name="Y", direction="+Y", travel_mm=(0.0, 2000.0), sensor="a"),),
    sensors=(Sensor(id="a", role="drive", axis="Y"), Sensor(id="b", role="structure"), Sensor(id="c", role="ambient")),
)


def _campaign(name: str, seed: int, *, states: int = 8, noise_um: float = 1.0, **settings: object) -> Campaign:
    """Intercept 12 µm/K and slope 5 µm/m/K on sensor a; b follows half of it late; c is unrelated."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(states) * 3600.0
    a = rng.uniform(5, 15) * (1 - np.exp(-t_s / rng.uniform(4000, 20000)))
    if seed % 2:
        a[states // 2 :] *= np.exp(-np.arange(states - states // 2) / 3.0)
    b = 0.5 * np.concatenate([[0.0], a[:-1]])
    c = rng.normal(0, 1, states)
    rises = np.column_stack([a, b, c - c[0]])
    components, columns = ("EXY", "EYY", "EZY"), []
    for k in range(3):
        scale = (1.0, -0.5, 0.7)[k]
        columns.append(
            (
                12.0 * scale * a + rng.normal(0, noise_um, states),
                5.0 * scale * a + rng.normal(0, noise_um, states),
            )
        )
    n = states * 3
    return Campaign(
        name=name,
        settings=CampaignSettings.model_validate(settings),
        temperatures=Temperatures(t_s, ("a", "b", "c"), 20.0 + rises),
        parameters=Parameters(
            t_s=np.tile(t_s, 3),
            component=tuple(np.repeat(components, states)),
            intercept_um=np.concatenate([column[0] for column in columns]),
            slope_um_per_m=np.concatenate([column[1] for column in columns]),
            p0_mm=np.zeros(n),
            p_min_mm=np.zeros(n),
            p_max_mm=np.full(n, 2000.0),
        ),
    )


def _folder(count: int, **settings: object) -> MachineFolder:
    return MachineFolder(MACHINE, tuple(_campaign(f"c{i}", i, **settings) for i in range(count)))  # type: ignore[arg-type]


def _states(count: int, **settings: object) -> AxisStates:
    folder = _folder(count, **settings)
    (states,) = axis_states(folder, separate_folder(folder), [c.name for c in folder.campaigns])
    return states


def _row(rows: tuple[ValidationRow, ...], component: str, model: str, split: str, campaign: str) -> ValidationRow:
    (row,) = (r for r in rows if (r.component, r.model, r.split, r.campaign) == (component, model, split, campaign))
    return row


def test_whole_campaigns_are_held_out() -> None:
    states = _states(3)
    split, folds = hold_out(states)
    assert split == "campaign"
    assert len(folds) == 3
    for fold in folds:
        assert not set(states.campaign[fold.train]) & set(states.campaign[fold.test])
        assert len(fold.train) + len(fold.test) == len(states)


def test_one_campaign_leaves_out_states_and_a_long_one_blocks() -> None:
    split, folds = hold_out(_states(1))
    assert (split, len(folds)) == ("state", 8)
    split, folds = hold_out(_states(1, states=100))
    assert (split, len(folds)) == ("block", 5)
    assert all(np.ptp(fold.test) == len(fold.test) - 1 for fold in folds)


def test_forward_in_time_trains_on_the_past() -> None:
    (fold,) = forward_in_time(_states(1))
    assert fold.train.tolist() == [0, 1, 2, 3]
    states = _states(3)
    (fold,) = forward_in_time(states)
    assert set(states.campaign[fold.train]) == {0, 1}


def test_the_model_recovers_the_truth_and_beats_the_clock_on_unseen_campaigns() -> None:
    analysis = analyze_folder(_folder(4))
    assert fit_for_use(analysis.acceptance)
    component = analysis.model.components["EXY"]
    assert len(component.terms) == 2
    inputs = analysis.model.control["Y"].layout.sensors
    by_name = dict(zip(inputs, component.terms[0].coefficients, strict=True))
    assert by_name["a"] == pytest.approx(12.0, abs=0.5)
    for name in ("EXY", "column_X", "column_Z"):
        default = _row(analysis.validation, name, "default", "campaign", "all")
        clocked = _row(analysis.validation, name, "clock", "campaign", "all")
        assert default.rms_after_um < 0.1 * clocked.rms_after_um
        assert default.reduction_percent > 90
    nothing = _row(analysis.validation, "EXY", "nothing", "campaign", "all")
    assert nothing.max_after_um == nothing.max_before_um
    assert nothing.reduction_percent == 0
    assert 90 <= _row(analysis.validation, "EXY", "default", "campaign", "all").coverage_percent <= 100


def test_column_deviation_is_the_largest_over_the_travel() -> None:
    """Closed form: for a line the maximum over the travel is at one of its ends."""
    analysis = analyze_folder(_folder(2))
    states = _states(2)
    ends = np.abs(states.intercept_um[:, 0, None] + states.slope_um_per_m[:, 0, None] * np.array([0.0, 2.0]))
    row = _row(analysis.validation, "column_X", "default", "campaign", "all")
    assert row.max_before_um == pytest.approx(ends.max())
    assert row.rms_before_um == pytest.approx(np.sqrt(np.mean(ends.max(axis=1) ** 2)))
    assert row.n == len(states)


def test_nothing_of_a_held_out_campaign_reaches_its_model() -> None:
    """Poison one campaign: the rows of that campaign change, the model that is judged there does not."""
    clean = _folder(3)
    poisoned = MachineFolder(MACHINE, (*clean.campaigns[:2], _campaign("c2", 2, noise_um=300.0)))
    names = ["c0", "c1", "c2"]
    models = []
    for folder in (clean, poisoned):
        (states,) = axis_states(folder, separate_folder(folder), names)
        fold = hold_out(states)[1][2]
        models.append(key_point_procedure(MACHINE)(states.take(fold.train)))
    assert models[0].inputs == models[1].inputs
    for component, regression in models[0].regressions.items():
        assert regression.coef_ == pytest.approx(models[1].regressions[component].coef_)


def test_train_and_test_choose_campaigns() -> None:
    analysis = analyze_folder(_folder(3), train=["c0", "c1"], test=["c2"])
    assert analysis.model.training.campaigns == ("c0", "c1")
    assert {row.campaign for row in analysis.validation if row.split == "test"} == {"c2"}
    with pytest.raises(AnalysisError, match="there is no campaign nope; the folder has c0, c1, c2"):
        analyze_folder(_folder(3), train=["nope"])
    with pytest.raises(AnalysisError, match="in --train and in --test"):
        analyze_folder(_folder(3), train=["c0"], test=["c0"])
    with pytest.raises(AnalysisError, match="no campaign is left for training"):
        analyze_folder(_folder(1), test=["c0"])


@pytest.mark.parametrize("tested", [1, 2])
def test_one_campaign_that_is_named_for_the_test_is_enough(tested: int) -> None:
    """The law of others foretells it: what one campaign of training and test alike could not prove."""
    analysis = analyze_folder(_folder(4), train=["c0", "c1"], test=["c2", "c3"][:tested])
    (check,) = [c for c in analysis.acceptance if "campaigns" in c.name]
    assert (check.name, check.statistic, check.threshold) == ("axis Y: campaigns for the test", tested, 1.0)
    assert fit_for_use(analysis.acceptance)


def test_modes_and_compensated_campaigns_are_not_mixed_unasked() -> None:
    cold, cooled = _campaign("off", 0, mode="no cooling"), _campaign("on", 1, mode="cooling")
    with pytest.raises(AnalysisError, match=r"different operating modes \(off: 'no cooling', on: 'cooling'"):
        analyze_folder(MachineFolder(MACHINE, (cold, cooled)))
    analyze_folder(MachineFolder(MACHINE, (cold, cooled)), train=["off"])
    active = _campaign("active", 1, compensation="on")
    with pytest.raises(AnalysisError, match="compensation was on in campaign active"):
        analyze_folder(MachineFolder(MACHINE, (_campaign("plain", 0), active)))


def test_different_datum_is_refused() -> None:
    folder = MachineFolder(MACHINE, (_campaign("own", 0), _campaign("shared", 1, datum="common")))
    with pytest.raises(AnalysisError, match="different datum"):
        analyze_folder(folder)


def test_with_a_common_datum_temperatures_share_one_zero() -> None:
    folder = _folder(2, datum="common")
    (states,) = axis_states(folder, separate_folder(folder), ["c0", "c1"])
    assert np.ptp(states.reference_degC, axis=0) == pytest.approx([0.0, 0.0, 0.0])


def test_the_model_document_carries_its_verdict() -> None:
    good = analyze_folder(_folder(4)).model
    assert good.failed_checks == ()
    rows = analyze_folder(_folder(4)).validation
    for found, model in ((good.prediction["Y"].components, "default"), (good.components, "key_points")):
        row = _row(rows, "EXY", model, "campaign", "all")
        assert found["EXY"].held_out_um == (row.rms_after_um, row.p95_after_um, row.max_after_um)
    single = analyze_folder(_folder(1)).model
    assert any("campaigns: 1 (must be >= 2)" in line for line in single.failed_checks)


def test_forward_split_is_not_counted_twice() -> None:
    """Of two campaigns the forward split is the fold that holds out the second: the same figures again."""
    assert not [row for row in analyze_folder(_folder(2)).validation if row.split == "forward"]
    assert [row for row in analyze_folder(_folder(4)).validation if row.split == "forward"]


def test_folds_that_choose_other_sensors_are_told() -> None:
    rng = np.random.default_rng(1)
    campaigns = [_campaign(f"c{i}", i, noise_um=60.0) for i in range(4)]
    twin = []
    for campaign in campaigns:
        degC = campaign.temperatures.value_degC.copy()
        degC[:, 1] = degC[:, 0] + rng.normal(0, 0.6, len(degC))
        heat = Temperatures(campaign.temperatures.t_s, campaign.temperatures.sensor_ids, degC)
        twin.append(Campaign(campaign.name, campaign.settings, heat, parameters=campaign.parameters))
    analysis = analyze_folder(MachineFolder(MACHINE, tuple(twin)))
    folder = MachineFolder(MACHINE, tuple(twin))
    (states,) = axis_states(folder, separate_folder(folder), [c.name for c in twin])
    procedure = key_point_procedure(MACHINE)
    stored = set(procedure(states).inputs)
    differ = sum(set(procedure(states.take(f.train)).inputs) != stored for f in hold_out(states)[1])
    told = [note for note in analysis.notes if "folds chose" in note]
    assert bool(told) == bool(differ)
    if differ:
        assert f"{differ} of 4 folds" in told[0]


def test_baselines_use_what_their_names_say() -> None:
    states = _states(3)
    assert clock(states).inputs == ("elapsed time",)
    assert all_sensors(states).inputs == ("a", "b", "c")
    mean = training_mean(states)
    value, _ = mean.predict("EXY", states, states.samples[0])
    expected = states.intercept_um[:, 0].mean() + states.slope_um_per_m[:, 0].mean() * states.samples[0].lever_m
    assert value == pytest.approx(expected)


def test_noise_is_not_accepted() -> None:
    """Temperatures that have nothing to do with the errors: the model must fail its acceptance."""
    rng = np.random.default_rng(12)
    campaigns = []
    for i in range(3):
        campaign = _campaign(f"c{i}", i)
        random = Temperatures(
            campaign.temperatures.t_s, ("a", "b", "c"), 20.0 + np.cumsum(rng.normal(0, 1, (8, 3)), axis=0)
        )
        campaigns.append(Campaign(campaign.name, campaign.settings, random, parameters=campaign.parameters))
    assert not fit_for_use(analyze_folder(MachineFolder(MACHINE, tuple(campaigns))).acceptance)


def test_permutation_tells_chance_from_truth() -> None:
    rng = np.random.default_rng(0)
    real = permutation_test(_states(1), key_point_procedure(MACHINE), rng)
    assert real is not None
    assert real.r2 > 0.99
    assert real.p_value == pytest.approx(0.01)
    assert real.r2_shuffled_median < 0.5
    assert permutation_test(_states(1).take(np.arange(4)), key_point_procedure(MACHINE), rng) is None


def test_three_of_thirty_sensors_on_eight_noise_states_look_excellent_by_chance() -> None:
    """The published pitfall: a median R² of 0.986 for 3 of 30 sensors on 8 samples of pure noise.

    Choosing the best by correlation gives a high R² here too; the permutation test must show that chance does it.
    """
    rng = np.random.default_rng(8)
    states = _states(1)
    wide = rng.normal(0, 1, (8, 30))
    from dataclasses import replace

    noise = replace(
        states,
        sensors=tuple(f"s{j}" for j in range(30)),
        rise_K=wide,
        reference_degC=np.zeros((8, 30)),
        intercept_um=rng.normal(0, 1, (8, 3)),
        slope_um_per_m=rng.normal(0, 1, (8, 3)),
    )

    def greedy(s: AxisStates):  # type: ignore[no-untyped-def]
        r = np.abs(np.corrcoef(s.rise_K.T, s.intercept_um[:, 0])[-1, :-1])
        return fit_axis(s, [s.sensors[j] for j in np.argsort(-r)[:3]])

    test = permutation_test(noise, greedy, rng)
    assert test is not None
    assert test.r2_shuffled_median > 0.3
    assert test.p_value > 0.05
