"""P-PI control: ``gains.position`` is K_v, ``gains.fast`` the pole of the velocity loop, ``gains.integral`` K_i."""

TITLE = "P-PI"
FMU = "PPi"
INPUTS = {
    "position_ref": "trajectory.position",
    "velocity_ref": "trajectory.velocity",
    "acceleration_ref": "trajectory.acceleration",
    "position": "plant.position",
}


def start(plant, gains, model):
    return {
        "K_v": gains.position,
        "K_p": plant.M * gains.fast,
        "K_i": gains.integral,
        "m_hat": plant.M,
        "b_hat": plant.B,
        "k_t": 1.0,
        "K_a": 1.0,
        "command_max": plant.force_max,
    }
