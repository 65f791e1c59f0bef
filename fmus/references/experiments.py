"""The experiments that every component is validated with; ``build_fmus.py --references`` makes their traces.

They move each component through all its regimes, with parameters other than the start values. Plants go through
presliding and reversals, controllers into saturation and out of it, sources through each of their kinds. No row lies on
a discontinuity, where a rounding error would decide the value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from cosim.model import exp, sin, where
from cosim.reference.exact import Validation
from fmus.controllers.cascade_pid import FeedForward
from fmus.controllers.disturbance_observer import ForceTiming
from fmus.controllers.friction_pulse import Mode
from fmus.controllers.nctf_fuzzy import Variant
from fmus.controllers.super_twisting import Switching
from fmus.physics.milling import Side
from fmus.physics.nct import Defuzzification
from fmus.physics.sampling import VelocitySource
from fmus.physics.sliding import FrictionVelocity
from fmus.references import maxwell_slip
from fmus.sources.trajectory import TrajectoryKind

Signal = Callable[[float], float]
TWO_PI = 6.283185307179586
STEP = Validation.step_size
"""The step size of the experiments in s, and the sampling time of most controllers in them."""


def constant(value: float) -> Signal:
    """``value`` at all times."""
    return lambda t: value


def sine(amplitude: float, frequency: float, phase: float = 0.0) -> Signal:
    """A sine of ``frequency`` in Hz."""
    return lambda t: amplitude * sin(TWO_PI * frequency * t + phase)


def slope(amplitude: float, frequency: float, phase: float = 0.0, order: int = 1) -> Signal:
    """The time derivative of ``sine``, first or second."""
    omega = TWO_PI * frequency
    return sine(amplitude * omega**order, frequency, phase + 0.25 * TWO_PI * order)


def after(time: float, signal: Signal) -> Signal:
    """0 before ``time``, then ``signal`` with its time starting at ``time``, s."""
    return lambda t: where(t < time, 0.0, signal(t - time))


def before(time: float, signal: Signal) -> Signal:
    """``signal`` before ``time``, then 0."""
    return lambda t: where(t < time, signal(t), 0.0)


def total(*signals: Signal) -> Signal:
    """The sum of signals."""
    return lambda t: sum(signal(t) for signal in signals)


def approach(distance: float, rate: float) -> Signal:
    """An exponential approach from 0 to ``distance`` with time constant 1/``rate``; ``rate`` in 1/s."""
    return lambda t: distance * (1.0 - exp(-rate * t))


def tracking(amplitude: float, frequency: float, error: float, error_frequency: float) -> Mapping[str, Signal]:
    """A sine as reference, and a measured motion that differs from it by another sine; frequencies in Hz."""
    off = 0.7
    return {
        "position_ref": sine(amplitude, frequency),
        "velocity_ref": slope(amplitude, frequency),
        "acceleration_ref": slope(amplitude, frequency, order=2),
        "position": total(sine(amplitude, frequency), sine(error, error_frequency, off)),
        "velocity": total(slope(amplitude, frequency), slope(error, error_frequency, off)),
    }


STAGE = tracking(1.6e-3, 2.0, 0.15e-3, 8.75)
"""Motion of a ballscrew stage, with errors that exceed the boundary layer of the start values."""
MICRO = tracking(10e-6, 2.0, 0.4e-6, 8.75)
"""The motion of a linear motor axis in micro-milling."""

NCTF = {name: signal for name, signal in tracking(1e-3, 1.0, 0.1e-3, 5.6).items() if name != "acceleration_ref"}
"""Motion with errors around the linear part of the NCT."""

HEAVY = {"m": 80.0, "v_s": 5.0, "sigma_1": 30.0}
"""A heavier ballscrew stage than at the start values, with a wider Stribeck curve and less damping of its bristles."""
DRIFT = {"F_C_negative": 0.8, "F_S_negative": 0.9, "drift_amplitude": 0.1, "drift_frequency": 6.0}
"""Friction that is less in negative direction and drifts during the experiment."""
REVERSALS = {"command": sine(17.0, 10.6, 2.0), "load_torque": after(0.1, constant(1.5))}
"""Torque of a ballscrew stage that reverses it several times, with a load from 0.1 s on."""
DIFFERENCED: Mapping[str, Any] = {"velocity_source": VelocitySource.difference, "velocity_filter_time": 4e-3}
"""A controller that takes the velocity from differences of the measured position."""
FALLING_DAMPING = {"sigma_0_hat": 1e4, "sigma_1_hat": 60.0, "v_s_hat": 5.0, "v_d_hat": 4.0}
"""The friction model of a controller, with a damping of its bristles that falls with speed."""
DISTURBED = {**MICRO, "disturbance_estimate": after(0.12, constant(0.02))}
"""The motion of a linear motor axis, with a disturbance from 0.12 s on."""
MOVES = {"out_and_back": True, "dwell": 0.05}
"""A trajectory that moves there and back."""

COMPLIANT = (
    Validation(
        name="reversals",
        description="Presliding, break-away and reversals with drifting Stribeck friction, a load on the table",
        steps=128,
        shown=("position", "velocity", "nut_force"),
        parameters={
            "m": 5.0,
            "F_S": 0.06,
            "v_s": 0.5,
            "F_C_negative": 0.9,
            "sigma_2_negative": 1.5,
            "drift_amplitude": 0.2,
            "drift_frequency": 7.0,
            "position_start": 5e-4,
        },
        stimuli={
            "command": total(before(2.0**-3, sine(0.2, 16.0)), after(2.0**-3, sine(1.0, 16.0))),
            "load_force": after(0.18, constant(20.0)),
        },
    ),
    Validation(
        name="backlash",
        description="Started at speed, impacts in the dead band of the nut, friction of guide and motor, a limit",
        steps=100,
        shown=("velocity", "nut_force", "guide_force"),
        parameters={
            "backlash": True,
            "gap_plus": 4e-6,
            "gap_minus": 3e-6,
            "motor_friction": True,
            "T_cm": 0.02,
            "guide_friction": True,
            "guide_sigma_0": 2e6,
            "guide_sigma_1": 1e3,
            "guide_sigma_2": 50.0,
            "guide_F_C": 15.0,
            "guide_F_S": 20.0,
            "command_max": 1.5,
            "motor_resolution": 1e-7,
            "position_resolution": 2e-8,
            "velocity_start": 1e-3,
        },
        stimuli={"command": sine(2.0, 12.5, 1.57), "load_torque": after(0.12, constant(0.01))},
    ),
    Validation(
        name="falling damping",
        description="Break-away and reversals, the damping of the bristles at screw and guide falls with speed",
        steps=96,
        shown=("position", "friction_torque", "guide_force"),
        parameters={
            "v_s": 2.0,
            "v_d": 3.0,
            "guide_friction": True,
            "guide_sigma_0": 2e6,
            "guide_sigma_1": 3e3,
            "guide_v_d": 1e-3,
            "guide_F_C": 15.0,
            "guide_F_S": 20.0,
        },
        stimuli={"command": total(before(2.0**-4, sine(0.3, 16.0)), after(2.0**-4, sine(0.9, 11.3)))},
    ),
)
LINEAR = (
    Validation(
        name="cutting",
        description="Cutting with run-out from 30 ms on, motor force in and out of its limit",
        steps=128,
        shown=("position", "motor_force", "cutting_force"),
        parameters={
            "m": 8.0,
            "feed_per_tooth": 1e-6,
            "spindle_speed": 12.0,
            "start_time": 0.03,
            "force_max": 0.3,
            "position_start": 1e-7,
        },
        stimuli={"command": sine(0.004, 6.25)},
    ),
    Validation(
        name="ploughing",
        description="The work on the axis, cutting and ploughing in part of a turn, position measured with 1 nm",
        steps=100,
        shown=("position", "velocity", "cutting_force"),
        parameters={
            "side": Side.table,
            "feed_per_tooth": 0.8e-6,
            "h_min": 0.5e-6,
            "spindle_speed": 14.0,
            "entry_angle": 0.4,
            "exit_angle": 2.6,
            "velocity_start": 1e-5,
            "position_resolution": 1e-9,
        },
        stimuli={"disturbance_force": after(0.08, constant(-0.1))},
    ),
)


def driven(validation: Validation, drive: str, **parameters: Any) -> Validation:
    """An experiment of a plant, made for the same plant with a drive; ``drive`` describes the effect of the drive."""
    return replace(
        validation, description=f"{validation.description}; {drive}", parameters={**validation.parameters, **parameters}
    )


EXPERIMENTS: Mapping[str, tuple[Validation, ...]] = {
    "BallscrewStage": (
        Validation(
            name="reversals",
            description="Presliding, then break-away and reversals in saturation, asymmetric drifting friction",
            steps=128,
            shown=("position", "velocity", "friction_torque"),
            parameters={
                **HEAVY,
                "command_max": 14.0,
                "F_C_negative": 0.8,
                "F_S_negative": 0.9,
                "sigma_2_negative": 1.2,
                "drift_amplitude": 0.1,
                "drift_frequency": 6.0,
                "position_start": 1e-4,
            },
            stimuli={
                "command": total(before(2.0**-4, sine(5.0, 16.0)), after(2.0**-4, sine(18.0, 10.4))),
                "load_torque": after(0.16, constant(1.5)),
            },
        ),
        Validation(
            name="play",
            description="Started at speed, reversals through the play, position measured with 1 um",
            steps=96,
            shown=("position", "velocity"),
            parameters={
                "play_positive": 80e-6,
                "play_negative": 40e-6,
                "resolution": 1e-6,
                "velocity_start": 5e-3,
                "bristle_start": 0.98,
            },
            stimuli={"command": sine(17.0, 10.6, 2.0)},
        ),
        Validation(
            name="falling damping",
            description="Presliding, break-away and reversals with a damping of the bristles that falls with speed",
            steps=96,
            shown=("position", "velocity", "friction_torque"),
            parameters={"m": 80.0, "v_s": 4.0, "sigma_1": 40.0, "v_d": 2.0},
            stimuli={"command": total(before(2.0**-4, sine(5.0, 16.0)), after(2.0**-4, sine(12.0, 8.3)))},
        ),
    ),
    "BallscrewStageElastoPlastic": (
        Validation(
            name="presliding",
            description="Loads that stay elastic, then loops that reach into slip, and break-away",
            steps=128,
            shown=("position", "velocity", "friction_torque"),
            parameters={**HEAVY, "v_d": 0.5, "elastic_share": 0.6},
            stimuli={"command": total(sine(3.5, 16.0), after(2.0**-4, sine(4.5, 8.0)), after(0.17, sine(9.0, 6.4)))},
        ),
        Validation(
            name="reversals",
            description="Started at speed, reversals, asymmetric drifting friction, position measured with 1 um",
            steps=96,
            shown=("position", "velocity", "friction_torque"),
            parameters={
                "v_s": 4.0,
                "sigma_0": 1e4,
                "sigma_1": 10.0,
                "v_d": 3.0,
                **DRIFT,
                "velocity_start": 4e-3,
                "resolution": 1e-6,
            },
            stimuli=REVERSALS,
        ),
    ),
    "BallscrewStageMaxwellSlip": (
        Validation(
            name="presliding",
            description="Nested loops below break-away, then break-away",
            solution=maxwell_slip.solution,
            steps=128,
            shown=("position", "velocity", "friction_torque"),
            parameters={**HEAVY, "v_d": 0.2},
            stimuli={"command": total(sine(4.0, 16.0), after(2.0**-4, sine(3.0, 8.0)), after(0.17, sine(9.0, 6.4)))},
        ),
        Validation(
            name="reversals",
            description="Started at speed, reversals, asymmetric drifting friction, position measured with 1 um",
            solution=maxwell_slip.solution,
            steps=96,
            shown=("position", "velocity", "friction_torque"),
            parameters={
                "v_s": 4.0,
                "sigma_1": 40.0,
                "v_d": 0.2,
                "k": (5e4, 2e4, 1e4, 5e3),
                "alpha": (0.4, 0.3, 0.2, 0.1),
                "C": 300.0,
                **DRIFT,
                "velocity_start": 4e-3,
                "resolution": 1e-6,
            },
            stimuli=REVERSALS,
        ),
    ),
    "BallscrewAxis": (
        Validation(
            name="rising friction",
            description="Friction that rises with speed, ripple, a drive with lag, in and out of its voltage limit",
            steps=128,
            shown=("position", "drive_torque", "friction_torque"),
            parameters={
                "F_S": 4.5,
                "v_s": 4.0,
                "sigma_0": 2e4,
                "sigma_1": 60.0,
                "v_d": 2.0,
                "drive_lag": 4e-3,
                "voltage_max": 25.0,
                "friction_ripple": (0.1, 0.04),
                "friction_phase": (0.4, -1.0),
                "torque_ripple": (0.2, 0.1),
                "torque_order": (6.0, 12.0),
                "torque_phase": (0.0, 0.9),
                "velocity_start": 4e-3,
            },
            stimuli={"command": sine(16.0, 7.3), "load_torque": after(0.16, constant(1.5))},
        ),
        Validation(
            name="errors of lead and encoder",
            description="Reversals with play, the lead long and uneven, an encoder with interpolation error and steps",
            steps=96,
            shown=("position", "velocity"),
            parameters={
                "v_s": 5.0,
                "sigma_1": 30.0,
                "play_positive": 60e-6,
                "play_negative": 30e-6,
                "lead_error": 2e-3,
                "lead_ripple": 2e-4,
                "lead_phase": 0.8,
                "encoder_period": 400e-6,
                "encoder_error": (9e-6, 4e-6),
                "encoder_phase": (0.3, -0.5),
                "resolution": 1e-6,
                "position_start": 2e-4,
            },
            stimuli={"command": sine(17.0, 10.6, 1.0)},
        ),
    ),
    "CompliantBallscrew": COMPLIANT,
    "CompliantBallscrewAxis": (
        driven(
            COMPLIANT[0],
            "a drive with lag and ripple",
            drive_lag=4e-3,
            torque_ripple=(4e-3, 2e-3),
            torque_order=(7.0, 12.0),
            torque_phase=(0.5, -0.8),
        ),
        driven(COMPLIANT[1], "a drive in and out of its voltage limit", voltage_max=2.5, R=1.2),
        driven(COMPLIANT[2], "a drive with lag and voltage limit", drive_lag=2e-3, voltage_max=3.0),
    ),
    "LinearMotor": LINEAR,
    "LinearMotorAxis": (
        driven(
            LINEAR[0],
            "an amplifier with lag, cogging",
            drive_lag=4e-3,
            magnet_pitch=2e-5,
            force_ripple=(0.05, 0.02),
            force_phase=(0.4, -1.1),
        ),
        driven(LINEAR[1], "cogging", magnet_pitch=1e-5, force_ripple=(0.03, 0.01)),
    ),
    "NominalStage": (
        Validation(
            name="moves",
            description="Moves in and out of the limit of the command, a disturbance, position measured with 1 um",
            steps=100,
            shown=("position", "velocity"),
            parameters={
                "alpha": 150.0,
                "command_max": 8.0,
                "position_resolution": 1e-6,
                "position_start": -2e-4,
                "velocity_start": 0.01,
            },
            stimuli={"command": sine(12.0, 9.0), "disturbance": after(0.12, constant(2.0))},
        ),
    ),
    "SlidingMode": (
        Validation(
            name="boundary layer",
            description="Inside and outside the boundary layer, friction model on the reference velocity",
            steps=128,
            shown=("command", "sliding_surface"),
            parameters={"T_s": STEP, "J_hat": 4e-4, "lambda_": 30.0, "v_s_hat": 5.0},
            stimuli=STAGE,
        ),
        Validation(
            name="integral surface",
            description="Surface with integral, differenced velocity, command limited, two steps a sample",
            steps=96,
            shown=("command", "sliding_surface"),
            parameters={
                "T_s": 2.0 * STEP,
                "integral_surface": True,
                "lambda_": 20.0,
                **DIFFERENCED,
                "friction_velocity": FrictionVelocity.measured,
                "command_max": 20.0,
            },
            stimuli=STAGE,
        ),
        Validation(
            name="falling damping",
            description="Friction model on the measured velocity, the damping of its bristles falls with speed",
            steps=64,
            shown=("command", "sliding_surface"),
            parameters={
                "T_s": STEP,
                "lambda_": 30.0,
                **FALLING_DAMPING,
                "friction_velocity": FrictionVelocity.measured,
            },
            stimuli=STAGE,
        ),
    ),
    "ComplementarySlidingMode": (
        Validation(
            name="boundary layer",
            description="Inside and outside the boundary layer, friction model on the measured velocity",
            steps=128,
            shown=("command", "complementary_surface"),
            parameters={
                "T_s": STEP,
                "lambda_": 20.0,
                "eta": 40.0,
                "v_s_hat": 5.0,
                "friction_velocity": FrictionVelocity.measured,
            },
            stimuli=STAGE,
        ),
        Validation(
            name="two samples a step",
            description="No friction model, differenced velocity, command limited, two samples a step",
            step_size=2.0 * STEP,
            steps=64,
            shown=("command", "sliding_surface"),
            parameters={
                "T_s": STEP,
                "lambda_": 25.0,
                **DIFFERENCED,
                "friction_velocity": FrictionVelocity.none,
                "command_max": 12.0,
            },
            stimuli=STAGE,
        ),
        Validation(
            name="falling damping",
            description="Friction model on the reference velocity, the damping of its bristles falls with speed",
            steps=64,
            shown=("command", "complementary_surface"),
            parameters={
                "T_s": STEP,
                "lambda_": 20.0,
                "eta": 40.0,
                **FALLING_DAMPING,
                "friction_velocity": FrictionVelocity.reference,
            },
            stimuli=STAGE,
        ),
    ),
    "FuzzySlidingMode": (
        Validation(
            name="rules",
            description="All nine rules, friction model on the reference velocity",
            steps=128,
            shown=("command", "fuzzy_command"),
            parameters={"T_s": STEP, "G_u": 60.0, "lambda_": 30.0, "v_s_hat": 5.0},
            stimuli=STAGE,
        ),
        Validation(
            name="limited",
            description="Command limited and integral held, friction model on a differenced velocity",
            steps=64,
            shown=("command", "sliding_surface"),
            parameters={
                "T_s": STEP,
                "lambda_": 25.0,
                **DIFFERENCED,
                "friction_velocity": FrictionVelocity.measured,
                "command_max": 25.0,
            },
            stimuli=STAGE,
        ),
        Validation(
            name="falling damping",
            description="Friction model on the measured velocity, the damping of its bristles falls with speed",
            steps=64,
            shown=("command", "fuzzy_command"),
            parameters={
                "T_s": STEP,
                "G_u": 60.0,
                "lambda_": 30.0,
                **FALLING_DAMPING,
                "friction_velocity": FrictionVelocity.measured,
            },
            stimuli=STAGE,
        ),
    ),
    "NctfPi": (
        Validation(
            name="point to point",
            description="A move of 0.5 mm: saturation with the integrator held, approach, overshoot, a step back",
            steps=128,
            shown=("command", "error", "velocity_hat"),
            parameters={"T_s": STEP, "K_P": 1200.0, "sensor_resolution": 1.7e-9, "velocity_filter_time": 2e-3},
            stimuli={
                "position_ref": total(constant(0.5e-3), after(0.2, constant(-0.1e-3))),
                "position": total(approach(0.503e-3, 32.0), sine(2e-6, 12.0)),
            },
        ),
        Validation(
            name="delayed",
            description="Command a sample late, velocity from its input, no anti-windup",
            steps=64,
            shown=("command", "rate_error"),
            parameters={
                "T_s": STEP,
                "compute_delay": 1,
                "sensor_resolution": 0.0,
                "antiwindup": False,
                "command_max": 3.0,
                "velocity_source": VelocitySource.input,
            },
            stimuli={"position_ref": constant(5e-5), "position": sine(6e-5, 5.0), "velocity": slope(6e-5, 5.0)},
        ),
    ),
    "NctfFuzzy": (
        Validation(
            name="proposed",
            description="Variant proposed with the exact centroid, errors around the linear part of the NCT",
            steps=100,
            shown=("command", "u_p", "u_i"),
            parameters={"T_s": STEP, "h_zero": 0.02, "u_i_zero": 2e-3, "command_max": 5.0},
            stimuli=NCTF,
        ),
        Validation(
            name="existing",
            description="Variant existing with singletons, differenced velocity, about a fixed target",
            steps=64,
            shown=("command", "u_p"),
            parameters={
                "T_s": STEP,
                "variant": Variant.existing,
                "defuzzification": Defuzzification.singleton,
                "K_f": 0.53,
                "h_zero": 28.36e-3,
                "u_i_zero": 0.384e-3,
                "velocity_source": VelocitySource.difference,
                "velocity_filter_time": 8e-3,
            },
            stimuli={"position_ref": constant(2e-5), "position": sine(0.12e-3, 9.4)},
        ),
        Validation(
            name="grid",
            description="Centroid over a grid of 21 points, near a fixed target",
            steps=48,
            shown=("command", "u_i"),
            parameters={
                "T_s": STEP,
                "defuzzification": Defuzzification.grid,
                "grid_points": 21,
                "h_zero": 5e-3,
                "u_i_zero": 2e-4,
            },
            stimuli={"position_ref": constant(1e-5), "position": sine(2e-5, 11.0), "velocity": slope(2e-5, 11.0)},
        ),
    ),
    "PPi": (
        Validation(
            name="tracking",
            description="A sine with errors, differenced velocity, a disturbance estimate",
            steps=128,
            shown=("force", "error", "beta"),
            parameters={"T_s": STEP, "K_v": 40.0, "K_i": 5.0, "velocity_filter_time": 4e-3},
            stimuli=DISTURBED,
        ),
        Validation(
            name="limited",
            description="Velocity from its input, command limited and integrator held, two steps a sample",
            steps=64,
            shown=("command", "beta"),
            parameters={
                "T_s": 2.0 * STEP,
                "K_p": 80.0,
                "K_i": 20.0,
                "command_max": 2.5e-4,
                "velocity_source": VelocitySource.input,
            },
            stimuli=MICRO,
        ),
    ),
    "SuperTwisting": (
        Validation(
            name="super-twisting",
            description="The surface crossed often, differenced velocity, a disturbance estimate",
            steps=128,
            shown=("force", "sliding_surface"),
            parameters={"T_s": STEP, "W": 0.2, "mu": 30.0, "velocity_filter_time": 4e-3},
            stimuli=DISTURBED,
        ),
        Validation(
            name="relay",
            description="Relay in place of the integral, velocity from its input, command limited",
            steps=64,
            shown=("command", "sliding_surface"),
            parameters={
                "T_s": STEP,
                "switching": Switching.relay,
                "W_relay": 0.005,
                "command_max": 2.5e-4,
                "velocity_source": VelocitySource.input,
            },
            stimuli=MICRO,
        ),
    ),
    "DisturbanceObserver": (
        Validation(
            name="force before",
            description="The force of the sample before, with a step; differenced velocity",
            steps=128,
            shown=("disturbance_estimate", "velocity_estimate"),
            parameters={"T_s": STEP, "g": 150.0, "m_hat": 9.0, "velocity_filter_time": 4e-3},
            stimuli={
                "position": sine(10e-6, 2.5),
                "applied_force": total(sine(0.3, 2.5, 0.5), after(0.1, constant(0.2))),
            },
        ),
        Validation(
            name="force present",
            description="The force of this sample, velocity from its input, two steps a sample",
            steps=64,
            shown=("disturbance_estimate",),
            parameters={
                "T_s": 2.0 * STEP,
                "force_timing": ForceTiming.present,
                "velocity_source": VelocitySource.input,
                "b_hat": 200.0,
            },
            stimuli={"velocity": slope(10e-6, 2.5), "applied_force": sine(0.3, 2.5, 0.5)},
        ),
    ),
    "CascadePid": (
        Validation(
            name="look-ahead",
            description="Feed-forward by look-ahead, differenced motor velocity, friction pulse, out of the limit",
            steps=128,
            shown=("command", "error", "velocity_estimate"),
            parameters={"T_s": STEP, "K_pos": 50.0, "omega_v": 200.0, "k_aff": 0.9, "command_max": 0.5},
            stimuli={
                "position_ref": sine(0.5e-3, 2.0),
                "position_next": lambda t: sine(0.5e-3, 2.0)(t + STEP),
                "position": total(sine(0.5e-3, 2.0, -0.05), sine(10e-6, 7.5)),
                "motor_position": total(sine(0.5e-3, 2.0, -0.03), sine(10e-6, 7.5)),
                "velocity_pulse": before(0.16, after(0.1, constant(1e-3))),
            },
        ),
        Validation(
            name="inputs",
            description="Feed-forward and velocity from inputs, a disturbance estimate, limited, two samples a step",
            step_size=2.0 * STEP,
            steps=64,
            shown=("force", "velocity_command"),
            parameters={
                "T_s": STEP,
                "feedforward_source": FeedForward.input,
                "velocity_source": VelocitySource.input,
                "integral_start": 200.0,
                "command_max": 0.5,
                "k_vff": 0.95,
            },
            stimuli={**tracking(0.5e-3, 2.0, 20e-6, 8.75), "disturbance_estimate": after(0.064, constant(-150.0))},
        ),
    ),
    "CascadeP": (
        Validation(
            name="tracking",
            description="A sine with a position that is off by another one, into the limit and out of it",
            steps=128,
            shown=("command", "velocity_estimate"),
            parameters={"T_s": STEP, "K_pos": 120.0, "K_vel": 300.0, "command_max": 4.0},
            stimuli={"position_ref": sine(2e-3, 2.0, 0.3), "position": total(sine(2e-3, 2.0, 0.2), sine(20e-6, 8.75))},
        ),
        Validation(
            name="two samples a step",
            description="Without limit, two samples a step",
            step_size=2.0 * STEP,
            steps=64,
            shown=("command", "error"),
            parameters={"T_s": STEP, "K_pos": 60.0, "command_max": 0.0},
            stimuli={"position_ref": approach(1e-3, 20.0), "position": approach(1e-3, 15.0)},
        ),
    ),
    "FrictionPulse": (
        Validation(
            name="tables",
            description="Two reversals of a sine, pulses by the tables",
            steps=128,
            shown=("velocity_pulse", "reverse_acceleration"),
            parameters={"T_s": STEP, "t_r": 8e-3},
            stimuli={"position_ref": sine(20e-6, 4.5), "position_next": lambda t: sine(20e-6, 4.5)(t + STEP)},
        ),
        Validation(
            name="fixed",
            description="Three fixed pulses, two steps a sample",
            steps=100,
            shown=("velocity_pulse", "time_since_reversal"),
            parameters={"T_s": 2.0 * STEP, "mode": Mode.fixed, "A": 0.5e-3, "T": 0.044},
            stimuli={"position_ref": sine(20e-6, 8.5), "position_next": lambda t: sine(20e-6, 8.5)(t + 2.0 * STEP)},
        ),
    ),
    "FrictionFeedforward": (
        Validation(
            name="reversals",
            description="Reversals of a sine, friction added to a force",
            steps=256,
            shown=("friction_hat", "command"),
            parameters={"T_s": STEP, "sigma_1_hat": 2e4, "sigma_2_hat": 400.0, "v_s_hat": 4e-3},
            stimuli={"force": sine(50.0, 7.0, 0.4), "velocity_ref": slope(0.5e-3, 3.0, 0.3)},
        ),
        Validation(
            name="share",
            description="Eight tenths of a softer friction, two steps a sample",
            steps=256,
            shown=("friction_hat", "command"),
            parameters={"T_s": 2.0 * STEP, "share": 0.8, "sigma_0_hat": 1e6, "F_S_hat": 90.0},
            stimuli={"velocity_ref": slope(1e-3, 4.0, 0.2)},
        ),
    ),
    "MillingForce": (
        Validation(
            name="slot",
            description="A slot with run-out: tooth 1 cuts more than tooth 2",
            steps=128,
            shown=("force_x", "force_y", "uncut_thickness[1]"),
            parameters={"run_out": 0.3e-6, "axial_depth": 40e-6, "spindle_speed": 6.5, "start_time": 0.015},
        ),
        Validation(
            name="ploughing",
            description="Forces on the work, part of a turn, chips below the minimum thickness",
            steps=128,
            shown=("force_x", "uncut_thickness[2]"),
            parameters={
                "side": Side.table,
                "h_min": 0.9e-6,
                "spindle_speed": 6.1,
                "feed_per_tooth": 0.5e-6,
                "entry_angle": 0.6,
                "exit_angle": 2.7,
            },
        ),
    ),
    "Trajectory": (
        Validation(
            name="step",
            description="A step at 0.2 s",
            step_size=2.0**-5,
            steps=16,
            shown=("position",),
            parameters={"kind": TrajectoryKind.step, "amplitude": 2e-3, "offset": 1e-3, "start_time": 0.2, "T_s": 0.01},
        ),
        Validation(
            name="stairs",
            description="Three steps up and down again",
            step_size=2.0**-5,
            steps=24,
            shown=("position",),
            parameters={"kind": TrajectoryKind.stairs, "repetitions": 3.0, "out_and_back": True, "dwell": 0.107},
        ),
        Validation(
            name="ramp",
            description="A ramp down with soft start and stop",
            step_size=2.0**-6,
            steps=40,
            shown=("position", "velocity"),
            parameters={"kind": TrajectoryKind.ramp, "feed": -0.02, "soft_start": 0.12, "start_time": 0.05},
        ),
        Validation(
            name="sine",
            description="One and a half periods with soft start",
            step_size=2.0**-6,
            steps=56,
            shown=("position", "velocity"),
            parameters={"frequency": 2.5, "phase": 0.3, "soft_start": 0.2, "turns": 1.5},
        ),
        Validation(
            name="quintic",
            description="Two moves out and back, limited by jerk",
            step_size=2.0**-6,
            steps=56,
            shown=("position", "velocity"),
            parameters={"kind": TrajectoryKind.quintic, "amplitude": 4e-3, "repetitions": 2.0, **MOVES},
        ),
        Validation(
            name="trapezoidal",
            description="A move out and back, limited by velocity",
            step_size=2.0**-6,
            steps=40,
            shown=("position", "velocity"),
            parameters={"kind": TrajectoryKind.trapezoidal, "amplitude": -4e-3, "velocity_max": 0.03, **MOVES},
        ),
        Validation(
            name="jerk-limited",
            description="A move out and back, limited by jerk, acceleration and velocity",
            step_size=2.0**-6,
            steps=48,
            shown=("position", "velocity"),
            parameters={"kind": TrajectoryKind.jerk_limited, "amplitude": 8e-3, **MOVES},
        ),
        Validation(
            name="circle",
            description="One turn, gaining and losing speed",
            step_size=2.0**-5,
            steps=32,
            shown=("position", "velocity"),
            parameters={
                "kind": TrajectoryKind.circle,
                "radius": 5e-3,
                "feed": 0.05,
                "phase": 0.7,
                "tangential_acceleration": 0.3,
                "turns": 1.0,
            },
        ),
    ),
}
"""Experiments by component."""
