"""Claims about the identification of declared models, on data that the package had no part in making."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import independent as ind
import numpy as np
import pinocchio as pin
import pytest
from scipy import stats

from rx90b_flex.effects import Effect, effect_from_table
from rx90b_flex.effects.stand_in import of_usual_shape
from rx90b_flex.identify.least_squares import Estimate, Identification, identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.shapes import USUAL
from rx90b_flex.robot import LINK_PARAMETERS, Robot, load_robot
from rx90b_flex.signals import Recording

RATE_HZ = 100.0
JOINTS = ("shoulder", "elbow")
COULOMB, VISCOUS = (2.0, 1.0), (3.0, 1.5)
NOISE = (0.3, 0.15)
SEEDS = 100
# two tails of 1e-4: twenty such limits hold together in 99.6 of a hundred fresh draws
TAIL = 1e-4
DEVIATIONS = 4.0  # standard deviations that an estimate may be off: 6e-5 of a normal distribution


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> ind.Arm:
    return ind.two_joints(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """The arm as its URDF states it."""
    folder = tmp_path_factory.mktemp("robot")
    ind.two_joints(folder)
    return load_robot(folder / "two_joints.urdf")


def on(joint: str, kind: str, **values: float) -> Effect:
    return effect_from_table({"type": kind, "joint": joint, **values}, "here", JOINTS)


TRUE_FRICTION = {f"{j}.coulomb_friction.torque": c for j, c in zip(JOINTS, COULOMB, strict=True)} | {
    f"{j}.viscous_friction.coefficient": v for j, v in zip(JOINTS, VISCOUS, strict=True)
}
FRICTION = tuple(on(j, kind) for j in JOINTS for kind in ("coulomb_friction", "viscous_friction"))


def recorded(item: ind.Run) -> Recording:
    return Recording("run", "identification", item.motion.time, RATE_HZ, JOINTS, item.motion.q, item.torque)


def motion(seed: int = 0, period_s: float = 16.0) -> ind.Motion:
    return ind.harmonics(np.random.default_rng(seed), 2, period_s=period_s, rate_hz=RATE_HZ, speed=2.0)


def data(
    arm: ind.Arm, robot: Robot, noise: np.ndarray, *more: ind.Torque, cutoff_hz: float | None = None
) -> Regression:
    """One recording of the arm with dry and viscous friction, and more."""
    m = motion(period_s=len(noise) / RATE_HZ)
    item = ind.run(arm, "identification", m, [ind.friction(COULOMB, VISCOUS), *more], noise)
    return Regression.of(robot, [recorded(item)], cutoff_hz)


def estimates(model: Identification) -> dict[str, Estimate]:
    """Every parameter by name, but turn-overs: the arm's dry friction is a step, of which a log tells an upper bound alone."""
    found = {e.name: e for e in model.link_estimates()}
    for i, effect in enumerate(model.effects):
        found |= {f"{effect.label}.{e.name}": e for e in model.estimates(i) if e.name != "turnover"}
    return found


def assert_within(found: Estimate, true: float) -> None:
    assert found.value is not None and found.std is not None
    assert abs(found.value - true) <= DEVIATIONS * found.std, (found, true)


# ---- values -------------------------------------------------------------------------------------------------


def true_links(arm: ind.Arm) -> np.ndarray:
    """m, m c, J about the joint in the order xx yy zz xy xz yz, by the parallel-axis theorem; (10 * links,)."""
    out = []
    for inertia in list(arm.model.inertias)[1:]:
        m, c = inertia.mass, inertia.lever
        J = inertia.inertia + m * (c @ c * np.eye(3) - np.outer(c, c))
        out += [m, *(m * c), *J[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]]
    return np.array(out)


def links_that_motion_tells(arm: ind.Arm, m: ind.Motion) -> np.ndarray:
    """Whether each link parameter has an effect of its own: rnea is linear in them, so differences give its columns."""
    base = true_links(arm)
    model = arm.model.copy()

    def torque(parameters: np.ndarray) -> np.ndarray:
        for i, p in enumerate(parameters.reshape(-1, 10)):
            J = np.array([[p[4], p[7], p[8]], [p[7], p[5], p[9]], [p[8], p[9], p[6]]])
            c = p[1:4] / p[0]
            model.inertias[i + 1] = pin.Inertia(p[0], c, J - p[0] * (c @ c * np.eye(3) - np.outer(c, c)))
        return ind.Arm("", model).torque(m).ravel()

    columns = np.stack([torque(base + step) - torque(base) for step in 0.01 * np.eye(len(base))], axis=1)
    _, values, directions = np.linalg.svd(columns)
    null = directions[values < 1e-9 * values[0]]
    return np.linalg.norm(null, axis=0) < 1e-6


@pytest.fixture(scope="module")
def fitted(arm: ind.Arm, robot: Robot) -> dict[str, Estimate]:
    """Links and friction of the arm from 16 s."""
    noise = ind.white(np.random.default_rng(5), 1600, NOISE)
    return estimates(identify(data(arm, robot, noise), FRICTION, fit_links=True))


def test_links_and_friction_are_recovered_within_their_standard_deviations(arm, robot, fitted):
    true = dict(zip(estimates_of_links(arm), true_links(arm), strict=True)) | TRUE_FRICTION
    assert set(true) == set(fitted)
    z = [(e.value - true[name]) / e.std for name, e in fitted.items() if e.value is not None]
    assert np.abs(z).max() < DEVIATIONS


def test_a_payload_on_a_tilted_base_is_recovered_with_the_tilt(arm, robot):
    """A payload as heavy as its link: a tilt of the links' weight alone would be told a third too large."""
    x, y, mass, centre = 0.04, -0.06, 2.0, np.array([0.25, 0.03, -0.02])
    model = arm.model.copy()
    place = model.frames[model.getFrameId("lower")]
    model.appendBodyToJoint(place.parentJoint, pin.Inertia(mass, centre, np.zeros((3, 3))), place.placement)
    model.gravity.linear = 9.81 * np.array([y, -x, -1.0])  # to first order, as the effect has it
    noise = ind.white(np.random.default_rng(6), 1600, NOISE)
    tilt = effect_from_table({"type": "base_tilt"}, "here", JOINTS)
    load = effect_from_table({"type": "payload", "frame": "lower"}, "here", JOINTS, ["lower"])
    regression = data(ind.Arm(arm.urdf, model), robot, noise)
    found = estimates(identify(regression, [*FRICTION, tilt, load], fit_links=False))
    true = {"robot.base_tilt.angle_x": x, "robot.base_tilt.angle_y": y, "lower.payload.mass": mass}
    true |= {f"lower.payload.centre_{i + 1}": c for i, c in enumerate(centre)}
    for name, value in true.items():
        assert_within(found[name], value)


def test_parameters_that_the_motion_does_not_tell_are_named_and_get_no_value(arm, fitted):
    links = [fitted[name] for name in estimates_of_links(arm)]
    told = links_that_motion_tells(arm, motion())
    assert 0 < told.sum() < len(told)
    assert [e.name for e in links if e.value is None] == [e.name for e, t in zip(links, told, strict=True) if not t]
    assert all((e.value is None) == (e.std is None) for e in links)


@pytest.mark.parametrize("quarter", ["1.5708", "1.570796", "1.570796327"])
def test_a_quarter_turn_in_a_few_digits_gives_no_link_a_moment_that_it_cannot_show(tmp_path, quarter):
    """The shoulder's axis is level but for the digits: the first moment along it turns neither joint."""
    text = ind.TWO_JOINTS.replace(
        '<axis xyz="0 1 0"/>', f'<origin xyz="0 0 0" rpy="{quarter} 0 {quarter}"/><axis xyz="0 0 1"/>'
    ).replace("two_joints", "level")
    turning = """<link name="column"><inertial><mass value="9"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>
      </inertial></link><joint name="turning" type="revolute"><parent link="base"/><child link="column"/>
      <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="5" effort="100"/></joint>"""
    text = text.replace('<link name="base"/>', f'<link name="base"/>{turning}')
    text = text.replace('<parent link="base"/><child link="upper"/>', '<parent link="column"/><child link="upper"/>')
    text = text.replace('<origin xyz="0 0 0" rpy', '<origin xyz="0 0.35 0.6" rpy')
    (tmp_path / "level.urdf").write_text(text)
    level = load_robot(tmp_path / "level.urdf")
    joints = level.joints
    m = ind.harmonics(np.random.default_rng(12), 3, period_s=20.0, rate_hz=RATE_HZ, speed=2.0)
    noise = ind.white(np.random.default_rng(13), 2000, (0.3, 0.3, 0.15))
    item = ind.run(ind.Arm("", pin.buildModelFromXML(text)), "identification", m, [], noise)
    recording = Recording("run", "identification", m.time, RATE_HZ, joints, m.q, item.torque)
    model = identify(Regression.of(level, [recording], None), [], fit_links=True)
    names = [f"{link}.{name}" for link, _ in level.bodies for name in LINK_PARAMETERS]
    found = {e.name: e for e in model.link_estimates()}
    fitted = dict(zip(names, model.link_parameters, strict=True))
    assert found["upper.s_z"].value is None
    assert fitted["upper.s_z"] == pytest.approx(level.link_parameters[names.index("upper.s_z")], abs=1e-6)
    assert np.abs(model.link_parameters).max() < 20.0
    left = model.residual.std(axis=0)
    np.testing.assert_allclose(left, (0.3, 0.3, 0.15), rtol=0.05)


def test_a_model_predicts_other_motion_as_well_as_its_own_although_parameters_are_undetermined(arm, robot):
    noise = ind.white(np.random.default_rng(5), 1600, NOISE)
    model = identify(data(arm, robot, noise), FRICTION, fit_links=True)
    item = ind.run(arm, "validation", motion(seed=9), [ind.friction(COULOMB, VISCOUS)], np.zeros((1600, 2)))
    other = Regression.of(robot, [recorded(item)], None)
    columns = np.concatenate([other.link_columns, *(other.columns(e) for e in model.effects)], axis=2)
    k = len(model.theta)
    variance = np.einsum("njk,kl,njl->j", columns, model.covariance[:k, :k], columns) / len(columns)
    error = model.residual_on(other)
    assert not model.solution.determined.all()
    assert (np.sqrt((error**2).mean(axis=0)) < DEVIATIONS * np.sqrt(variance)).all()


def test_links_that_are_known_stay_as_they_are(arm, robot):
    model = identify(data(arm, robot, np.zeros((800, 2))), FRICTION, fit_links=False)
    np.testing.assert_array_equal(model.link_parameters, robot.link_parameters)
    assert all(e.value is None for e in model.link_estimates())


def test_a_drive_inertia_that_a_fitted_link_can_play_gets_no_value(arm, robot):
    regression = data(arm, robot, ind.white(np.random.default_rng(1), 800, NOISE))
    drive = on("shoulder", "drive_inertia", inertia=0.3)
    fitted = estimates(identify(regression, [*FRICTION, drive], fit_links=True))
    known = estimates(identify(regression, [*FRICTION, drive], fit_links=False))
    assert fitted["shoulder.drive_inertia.inertia"].value is None
    assert fitted["upper.J_yy"].value is None  # the other half of the same ambiguity
    assert_within(known["shoulder.drive_inertia.inertia"], 0.0)


def test_a_spring_beside_a_constant_torque_has_a_stiffness_but_no_rest_angle(arm, robot):
    spring = ind.hidden("joint_spring", 1, {"stiffness": 4.0, "rest_angle": 0.3})
    regression = data(arm, robot, ind.white(np.random.default_rng(1), 800, NOISE), spring)
    beside = [*FRICTION, on("elbow", "torque_offset"), on("elbow", "joint_spring")]
    found = estimates(identify(regression, beside, fit_links=False))
    assert_within(found["elbow.joint_spring.stiffness"], 4.0)
    assert found["elbow.joint_spring.rest_angle"].value is None
    assert found["elbow.torque_offset.torque"].value is None
    alone = estimates(identify(regression, [*FRICTION, on("elbow", "joint_spring")], fit_links=False))
    assert_within(alone["elbow.joint_spring.rest_angle"], 0.3)


def test_a_joint_that_stands_still_leaves_its_friction_without_a_value(arm, robot):
    moving = motion(period_s=8.0)
    still = ind.Motion(moving.time, moving.q * [1, 0], moving.v * [1, 0], moving.a * [1, 0])
    item = ind.run(arm, "identification", still, [ind.friction(COULOMB, VISCOUS)], np.zeros((800, 2)))
    model = identify(Regression.of(robot, [recorded(item)], None), FRICTION, fit_links=False)
    found = estimates(model)
    assert found["elbow.viscous_friction.coefficient"].value is None
    assert found["elbow.coulomb_friction.torque"].value is None
    assert found["shoulder.viscous_friction.coefficient"].value == pytest.approx(VISCOUS[0], rel=1e-2)


# ---- weights ------------------------------------------------------------------------------------------------


def test_friction_below_zero_is_named_as_impossible_and_what_noise_alone_puts_there_is_not(arm, robot):
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(1600, 2)) * NOISE

    def driven(m: ind.Motion, load: np.ndarray) -> np.ndarray:
        """Takes away the elbow's dry friction and half as much again: no gear does that."""
        return -1.5 * COULOMB[1] * np.sign(m.v) * [0.0, 1.0]

    def without(m: ind.Motion, load: np.ndarray) -> np.ndarray:
        return -COULOMB[1] * np.sign(m.v) * [0.0, 1.0]

    wrong, none = (identify(data(arm, robot, noise, x), FRICTION, fit_links=True) for x in (driven, without))
    assert [e.label for e in wrong.impossible()] == ["elbow.coulomb_friction"]
    assert none.impossible() == ()


def test_each_joint_is_weighted_by_its_own_noise(arm, robot):
    noise = ind.white(np.random.default_rng(2), 3000, NOISE)
    model = identify(data(arm, robot, noise), FRICTION, fit_links=True)
    # a standard deviation from N samples is known to 1 / sqrt(2 N)
    np.testing.assert_allclose(model.solution.sigma, NOISE, rtol=DEVIATIONS / np.sqrt(2 * 3000))


def test_a_noisy_joint_does_not_spoil_what_a_quiet_one_tells(arm, robot):
    """`lower.s_x` shows in both joints; with one common weight the noisy one would decide."""
    found = {}
    for loud in (0.05, 50.0):
        noise = ind.white(np.random.default_rng(2), 1600, (loud, 0.05))
        found[loud] = estimates(identify(data(arm, robot, noise), FRICTION, fit_links=True))["lower.s_x"]
    assert found[50.0].std < 3 * found[0.05].std
    assert_within(found[50.0], true_links(arm)[11])


def estimates_of_links(arm: ind.Arm) -> tuple[str, ...]:
    """Names of the link parameters, as robots give them."""
    kinds = ("mass", "s_x", "s_y", "s_z", "J_xx", "J_yy", "J_zz", "J_xy", "J_xz", "J_yz")
    return tuple(f"{link}.{kind}" for link in ("upper", "lower") for kind in kinds)


# ---- standard deviations ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Scatter:
    """Estimates of many experiments that differ in their noise alone, (SEEDS, parameters)."""

    names: tuple[str, ...]
    value: np.ndarray
    std: np.ndarray
    white_std: np.ndarray  # what the textbook formula for white noise says

    @property
    def ratio(self) -> np.ndarray:
        """Variance between experiments over the mean reported one: chi-square / degrees of freedom if that is true."""
        return self.value.var(axis=0, ddof=1) / (self.std**2).mean(axis=0)

    @property
    def white_ratio(self) -> np.ndarray:
        return self.value.var(axis=0, ddof=1) / (self.white_std**2).mean(axis=0)


def chi_square_limits(freedom: int) -> tuple[float, float]:
    low, high = stats.chi2.ppf([TAIL, 1 - TAIL], freedom) / freedom
    return float(low), float(high)


def scatter(
    regression: Callable[[int], Regression], effects: Sequence[Effect], fit_links: bool, seeds: int = SEEDS
) -> Scatter:
    rows = []
    for seed in range(seeds):
        model = identify(regression(seed), effects, fit_links=fit_links)
        found = {name: e for name, e in estimates(model).items() if e.value is not None}
        plain = estimates(_as_if_white(model))
        rows.append([(e.value, e.std, plain[name].std) for name, e in found.items()])
    value, std, white_std = np.moveaxis(np.array(rows, dtype=float), 2, 0)
    return Scatter(tuple(found), value, std, white_std)


def _as_if_white(model: Identification) -> Identification:
    """The same fit with the covariance sigma^2 (X' X)^-1."""
    white = dataclasses.replace(model.uncertainty)
    k = len(model.theta)
    white.__dict__["covariance"] = covariance = model.covariance.copy()
    covariance[:k, :k] = model.solution.inverse
    return dataclasses.replace(model, uncertainty=white)


@cache
def _noises(colour: str) -> tuple[np.ndarray, ...]:
    draw = {
        "white": lambda rng: ind.white(rng, 1600, NOISE),
        "coloured": lambda rng: ind.coloured(rng, 1600, NOISE, memory=0.9),
    }[colour]
    return tuple(draw(np.random.default_rng([3, seed])) for seed in range(SEEDS))


@pytest.fixture(scope="module")
def scatters(arm: ind.Arm, robot: Robot) -> dict[str, Scatter]:
    """Links and friction, fitted to 16 s under white and under coloured noise."""
    clean = data(arm, robot, np.zeros((1600, 2)))
    return {
        colour: scatter(lambda seed, c=colour: _with_noise(clean, _noises(c)[seed]), FRICTION, True)  # type: ignore[misc]
        for colour in ("white", "coloured")
    }


def _with_noise(clean: Regression, noise: np.ndarray) -> Regression:
    """The same motion, differentiated once, with noise on its torque."""
    (segment,) = clean.segments
    other = dataclasses.replace(segment, torque=segment.torque + noise[segment.kept])
    regression = dataclasses.replace(clean, segments=(other,))
    regression.__dict__["link_columns"] = clean.link_columns  # worked out once: they do not hold the torque
    return regression


@pytest.mark.parametrize("colour", ["white", "coloured"])
def test_standard_deviations_are_what_repeated_experiments_scatter_by(scatters, colour):
    low, high = chi_square_limits(SEEDS - 1)
    ratio = scatters[colour].ratio
    assert (ratio > low).all() and (ratio < high).all(), dict(zip(scatters[colour].names, ratio, strict=True))


@pytest.mark.parametrize("colour", ["white", "coloured"])
def test_standard_deviations_are_right_on_average_over_the_parameters(scatters, colour):
    """Sharper than one parameter at a time: as many independent ones as their correlations leave."""
    s = scatters[colour]
    correlation = np.corrcoef(s.value, rowvar=False)
    # variances of correlated estimates correlate by the square
    independent = len(s.names) ** 2 / (correlation**2).sum()
    low, high = chi_square_limits(round(independent * (SEEDS - 1)))
    assert low < s.ratio.mean() < high


def test_the_formula_for_white_noise_would_be_wrong_under_coloured_noise(scatters):
    _, high = chi_square_limits(SEEDS - 1)
    friction = [i for i, name in enumerate(scatters["coloured"].names) if "friction" in name]
    assert (scatters["coloured"].white_ratio[friction] > high).all()
    assert (scatters["white"].white_ratio[friction] < high).all()


@pytest.mark.parametrize("colour", ["white", "coloured"])
def test_the_mean_of_repeated_experiments_is_the_truth(arm, scatters, colour):
    s = scatters[colour]
    true = dict(zip(estimates_of_links(arm), true_links(arm), strict=True)) | TRUE_FRICTION
    for i, name in enumerate(s.names):
        off = abs(s.value[:, i].mean() - true[name])
        assert off < DEVIATIONS * s.value[:, i].std(ddof=1) / np.sqrt(SEEDS), name


# ---- shape parameters ---------------------------------------------------------------------------------------

STRIBECK = {"torque": 3.0, "velocity": 0.25, "power": 1.3}


@pytest.fixture(scope="module")
def stribeck(arm: ind.Arm, robot: Robot) -> Scatter:
    """Stribeck friction at the elbow, its shape estimated, in repeated experiments under coloured noise."""
    hidden = ind.hidden("stribeck_friction", 1, STRIBECK)
    clean = data(arm, robot, np.zeros((1600, 2)), hidden)
    model = [*FRICTION, on("elbow", "stribeck_friction")]
    noises = [ind.coloured(np.random.default_rng([4, seed]), 1600, (0.3, 0.4), memory=0.7) for seed in range(SEEDS)]
    return scatter(lambda seed: _with_noise(clean, noises[seed]), model, False)


@pytest.mark.parametrize("name", STRIBECK)
def test_variable_projection_recovers_a_stribeck_curve(stribeck, name):
    i = stribeck.names.index(f"elbow.stribeck_friction.{name}")
    z = (stribeck.value[:, i] - STRIBECK[name]) / stribeck.std[:, i]
    assert np.abs(z).max() < stats.norm.isf(TAIL / SEEDS / 2)  # the largest of SEEDS
    assert np.median(stribeck.std[:, i]) < 0.2 * STRIBECK[name]  # the interval says something


def test_standard_deviations_of_shape_parameters_are_what_repeated_experiments_scatter_by(stribeck):
    low, high = chi_square_limits(SEEDS - 1)
    shapes = [stribeck.names.index(f"elbow.stribeck_friction.{name}") for name in STRIBECK]
    assert (stribeck.ratio[shapes] > low).all() and (stribeck.ratio[shapes] < high).all()


@pytest.mark.parametrize("start", [{"velocity": 0.05, "power": 0.6}, {"velocity": 0.4, "power": 2.0}])
def test_a_fit_ends_at_the_same_shape_from_wherever_it_starts(arm, robot, start):
    noise = ind.white(np.random.default_rng(6), 1600, NOISE)
    regression = data(arm, robot, noise, ind.hidden("stribeck_friction", 1, STRIBECK))
    far, near = (
        estimates(identify(regression, [*FRICTION, on("elbow", "stribeck_friction", **at)], fit_links=False))
        for at in (start, {"velocity": STRIBECK["velocity"], "power": STRIBECK["power"]})
    )
    for name in STRIBECK:
        one, other = far[f"elbow.stribeck_friction.{name}"], near[f"elbow.stribeck_friction.{name}"]
        # steps end where they gain 1e-7 of the squares of some 3000 samples: 0.02 standard deviations
        assert one.value == pytest.approx(other.value, rel=0, abs=0.05 * other.std)


@pytest.mark.parametrize("power", [0.7, 1.5])
def test_a_shape_that_is_held_at_what_is_usual_counts_as_known_no_better_than_that(arm, robot, power):
    usual = of_usual_shape(on("elbow", "stribeck_friction", torque=1.0, velocity=0.2, power=1.0))
    assert usual is not None
    for seed in range(4):
        noise = ind.white(np.random.default_rng([8, seed]), 1600, NOISE)
        hidden = ind.hidden("stribeck_friction", 1, STRIBECK | {"power": power})
        found = estimates(identify(data(arm, robot, noise, hidden), [*FRICTION, usual], fit_links=False))
        held = found["elbow.stribeck_friction.power"]
        assert held.value == 1.0 and 0.0 < held.std <= USUAL
        for name in ("torque", "velocity"):
            assert_within(found[f"elbow.stribeck_friction.{name}"], STRIBECK[name])


@pytest.mark.parametrize("power", [0.5, 1.6])
def test_variable_projection_recovers_the_power_of_viscous_friction(arm, robot, power):
    noise = ind.white(np.random.default_rng(6), 1600, NOISE)
    m = motion()
    law = ind.hidden("viscous_power_friction", 1, {"coefficient": 2.0, "power": power})
    item = ind.run(arm, "identification", m, [ind.friction(COULOMB, (VISCOUS[0], 0.0)), law], noise)
    model = [*FRICTION[:3], on("elbow", "viscous_power_friction")]
    found = estimates(identify(Regression.of(robot, [recorded(item)], None), model, fit_links=False))
    assert_within(found["elbow.viscous_power_friction.coefficient"], 2.0)
    assert_within(found["elbow.viscous_power_friction.power"], power)


def test_the_order_of_a_gear_ripple_is_estimated_with_its_amplitude_and_phase(arm, robot):
    noise = ind.white(np.random.default_rng(7), 1600, NOISE)
    true = {"order": 12.3, "amplitude": 0.2, "phase": -2.0}
    regression = data(arm, robot, noise, ind.hidden("gear_ripple", 1, true))
    found = estimates(identify(regression, [*FRICTION, on("elbow", "gear_ripple", order=12.0)], fit_links=False))
    for name, value in true.items():
        assert_within(found[f"elbow.gear_ripple.{name}"], value)


# ---- load ---------------------------------------------------------------------------------------------------


def test_load_friction_sees_the_load_of_the_fitted_links_not_of_the_urdf(robot):
    """The arm is 1.5 times as heavy as its URDF says: with that load the coefficient would be 1.5 times too large."""
    model = pin.buildModelFromXML(ind.TWO_JOINTS)
    for i, inertia in enumerate(model.inertias):
        model.inertias[i] = pin.Inertia(1.5 * inertia.mass, inertia.lever, 1.5 * inertia.inertia)
    heavy = ind.Arm("", model)
    noise = ind.white(np.random.default_rng(8), 3000, (0.1, 0.05))
    regression = data(heavy, robot, noise, ind.hidden("load_friction", 0, {"coefficient": 0.1}))
    found = estimates(identify(regression, [*FRICTION, on("shoulder", "load_friction")], fit_links=True))
    coefficient = found["shoulder.load_friction.coefficient"]
    assert coefficient.std is not None and coefficient.std < 0.1 * 0.1 / DEVIATIONS
    assert_within(coefficient, 0.1)


# ---- the low-pass -------------------------------------------------------------------------------------------


def test_the_same_low_pass_on_columns_and_torque_leaves_the_estimates_unbiased(arm, robot):
    noise = ind.white(np.random.default_rng(9), 3000, NOISE)
    found = estimates(identify(data(arm, robot, noise, cutoff_hz=8.0), FRICTION, fit_links=False))
    for name, value in TRUE_FRICTION.items():
        assert_within(found[name], value)
