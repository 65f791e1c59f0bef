"""Cascade control: position loop, PI velocity loop with integral time 1/``gains.integral``, feed-forward."""

TITLE = "Cascade"
FMU = "CascadePid"
INPUTS = {
    "position_ref": "trajectory.position",
    "position_next": "trajectory.position_next",
    "position": "plant.position",
    "motor_position": "plant.position",
}
CANCELS_DAMPING = False


def start(plant, gains, model):
    return {
        "K_pos": gains.position,
        "omega_v": gains.fast,
        "T_i": 1.0 / gains.integral,
        "M": plant.M,
        "l_p": 1.0,
        "command_max": plant.force_max,
    }
