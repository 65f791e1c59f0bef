"""Cascade control with a disturbance observer: its cut-off is ``gains.integral``, the integral time stays 8/fast."""

TITLE = "Cascade + observer"
FMU = "CascadePid"
INPUTS = {
    "position_ref": "trajectory.position",
    "position_next": "trajectory.position_next",
    "position": "plant.position",
    "motor_position": "plant.position",
    "disturbance_estimate": "observer.disturbance_estimate",
}
CANCELS_DAMPING = False


def start(plant, gains, model):
    return {
        "K_pos": gains.position,
        "omega_v": gains.fast,
        "T_i": 8.0 / gains.fast,
        "M": plant.M,
        "l_p": 1.0,
        "command_max": plant.force_max,
    }


def before(plant, gains, model):
    """Instances that run before the controller: name -> (FMU, start values, input -> source)."""
    inputs = {"position": "plant.position", "applied_force": "controller.force"}
    # applied_force does not include the feed-forward of friction, so the observer estimates the remaining friction.
    start = {"g": gains.integral, "m_hat": plant.M, "b_hat": plant.B}
    return {"observer": ("DisturbanceObserver", start, inputs)}
