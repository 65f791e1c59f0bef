"""Super-twisting control: surface of two gains, switching gains by Levant's rule for the bound C."""

import math

TITLE = "Super-twisting"
FMU = "SuperTwisting"
INPUTS = {
    "position_ref": "trajectory.position",
    "velocity_ref": "trajectory.velocity",
    "acceleration_ref": "trajectory.acceleration",
    "position": "plant.position",
}


def start(plant, gains, model):
    # Levant's 1.5 sqrt(C), 1.1 C; C: friction and reserve change within 1/fast.
    C = (plant.F_C / plant.M + plant.reserve) * gains.fast
    return {
        "mu": gains.position,
        "lambda_": gains.integral * gains.position,
        "Lambda": 1.5 * plant.M * math.sqrt(C),
        "W": 1.1 * plant.M * C,
        "m_hat": plant.M,
        "b_hat": plant.B,
        "k_t": 1.0,
        "K_a": 1.0,
        "command_max": plant.force_max,
    }
