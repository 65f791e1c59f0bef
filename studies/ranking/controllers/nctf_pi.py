"""NCTF control with PI compensator: a straight NCT of slope ``gains.position``; it does not see the velocity."""

TITLE = "NCTF PI"
FMU = "NctfPi"
INPUTS = {"position_ref": "trajectory.position", "position": "plant.position"}
CANCELS_DAMPING = False


def start(plant, gains, model):
    slope, reach = gains.position, 0.5
    return {
        "K_P": plant.M * gains.fast,
        "K_I": plant.M * gains.fast * gains.integral,
        "nct.error": [0.0, *([reach / slope] * 127)],
        "nct.rate": [0.0, *([reach] * 127)],
        "sensor_resolution": 0.0,
        "command_max": plant.force_max,
    }
