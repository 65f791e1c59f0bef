"""Fuzzy sliding-mode control: slope ``gains.position``, scalings from ``gains.fast``, range from ``gains.integral``."""

TITLE = "FSMC"
FMU = "FuzzySlidingMode"
INPUTS = {
    "position_ref": "trajectory.position",
    "velocity_ref": "trajectory.velocity",
    "acceleration_ref": "trajectory.acceleration",
    "position": "plant.position",
}
AT_SCREW = True
OWN_MODEL = True


def start(plant, gains, model):
    common, _, gain = plant.sliding_mode(gains, model=model)
    G_u = 1.2 * gain
    G_s = common["J_hat"] * gains.fast / (0.375 * G_u)
    return {**common, "G_u": G_u, "G_s": G_s, "G_c": 0.5 * G_s}
