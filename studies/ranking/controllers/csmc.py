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
    l_p = plant.lead
    inertia = plant.M * l_p**2
    sigma_0, sigma_1, sigma_2, v_s = plant.friction
    reserve = plant.reserve * 8.0 * gains.integral / gains.fast
    gain = plant.F_S * l_p + inertia * reserve / l_p
    common = {
        "l_p": l_p,
        "J_hat": inertia,
        "lambda_": gains.position,
        "sigma_0_hat": sigma_0,
        "sigma_1_hat": sigma_1 if plant.F_S > 0.0 else 0.0,
        "sigma_2_hat": sigma_2 if plant.F_S > 0.0 else plant.B * l_p**2,
        "F_C_hat": max(0.8 * plant.F_C * l_p, 1e-9),
        "F_S_hat": max(0.8 * plant.F_S * l_p, 1e-9),
        "v_s_hat": v_s,
        "friction_velocity": "reference" if model or plant.F_S == 0.0 else "none",
        "command_max": plant.force_max * l_p,
    }
    return {**common, "sigma_2_tilde": 0.0, "eta": reserve / l_p, "phi": 2.0 * gain / (inertia * gains.fast)}
