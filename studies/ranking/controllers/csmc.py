"""Complementary sliding-mode control: free values as for SMC; the loop gain is twice that of the boundary layer."""

TITLE = "CSMC"
FMU = "ComplementarySlidingMode"
INPUTS = {
    "position_ref": "trajectory.position",
    "velocity_ref": "trajectory.velocity",
    "acceleration_ref": "trajectory.acceleration",
    "position": "plant.position",
}
AT_SCREW = True
OWN_MODEL = True


def start(plant, gains, model):
    common, reserve, gain = plant.sliding_mode(gains, model=model)
    phi = 2.0 * gain / (common["J_hat"] * gains.fast)
    return {**common, "sigma_2_tilde": 0.0, "eta": reserve / plant.lead, "phi": phi}
