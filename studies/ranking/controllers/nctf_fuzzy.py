"""NCTF control with fuzzy compensator: NCT of slope ``gains.position``, widths of its sets from the other two."""

TITLE = "NCTF fuzzy"
FMU = "NctfFuzzy"
INPUTS = {
    "position_ref": "trajectory.position",
    "velocity_ref": "trajectory.velocity",
    "position": "plant.position",
}
CANCELS_DAMPING = False


def start(plant, gains, model):
    h_max, slope = 0.5, gains.position
    h_zero = plant.force_max / (2.0 * plant.M * gains.fast)
    return {
        "alpha": slope,
        "e_1": 0.5 * h_max / slope,
        "A": 2.0 * h_max / slope,
        "h_max": h_max,
        "h_zero": h_zero,
        "u_i_max": h_max / gains.integral,
        "u_i_zero": h_zero / gains.integral,
        "u_r": plant.force_max,
        "w_z": 0.02 * plant.force_max,
        "command_max": plant.force_max,
    }
