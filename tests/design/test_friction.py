"""First values of friction from a log: near the truth where the log excites them, not given where it does not."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cosim.commands.cli import main
from cosim.design.friction import FrictionLook, friction_from_signals, identify_friction
from cosim.errors import DescriptionError

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples" / "your_machine"
sys.path.insert(0, str(EXAMPLES))
from make_records import STAGE  # noqa: E402

FACTOR = STAGE["torque"] / STAGE["l_p"]
"""N/V at the table."""


@pytest.fixture(scope="module")
def stage() -> FrictionLook:
    return identify_friction(
        EXAMPLES / "stage.csv", position="position", force="command", factor=FACTOR, force_unit="N"
    )


@pytest.mark.parametrize(
    ("name", "truth", "share"),
    [
        # The delay of the position and the falling part of the curve, which the straight law does not have, cost 2 %.
        ("inertia", STAGE["m"] + STAGE["J_rot"] / STAGE["l_p"] ** 2, 0.03),
        ("Coulomb friction", STAGE["F_C"] / STAGE["l_p"], 0.02),
        ("Coulomb friction positive", STAGE["F_C"] / STAGE["l_p"], 0.02),
        ("Coulomb friction negative", STAGE["F_C"] / STAGE["l_p"], 0.02),
        ("viscous friction", STAGE["sigma_2"] / STAGE["l_p"] ** 2, 0.02),
        # The largest of noisy samples while the stage begins to run lies above the break-away force.
        ("break-away friction", STAGE["F_S"] / STAGE["l_p"], 0.10),
        ("presliding stiffness", STAGE["sigma_0"] / STAGE["l_p"] ** 2, 0.05),
    ],
)
def test_first_values_of_the_made_up_stage(stage: FrictionLook, name: str, truth: float, share: float) -> None:
    value = stage.value(name)
    assert value.excited
    assert value.value == pytest.approx(truth, rel=share)


def test_the_curve_falls_and_rises_in_both_directions(stage: FrictionLook) -> None:
    l_p = STAGE["l_p"]
    for curve, sign in ((stage.positive, 1.0), (stage.negative, -1.0)):
        assert np.all(sign * curve.velocity > 0.0)
        rate = curve.velocity / l_p
        level = STAGE["F_C"] + (STAGE["F_S"] - STAGE["F_C"]) * np.exp(-((rate / STAGE["v_s"]) ** 2))
        wanted = (sign * level + STAGE["sigma_2"] * rate) / l_p
        assert np.all(np.abs(curve.friction - wanted) < 0.08 * np.abs(wanted))


def fast_motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An axis of 90 kg with 20 N and 200 N.s/m that only moves fast, at 1 kHz; by the equations of sliding."""
    t = 1e-3 * np.arange(4000)
    amplitude, omega = 0.05, 2.0 * math.pi
    x = -amplitude * np.cos(omega * t)
    v, a = amplitude * omega * np.sin(omega * t), amplitude * omega**2 * np.cos(omega * t)
    force = 90.0 * a + 20.0 * np.sign(v) + 200.0 * v
    random = np.random.default_rng(0)
    return t, x + 1e-7 * random.standard_normal(len(t)), force + 0.2 * random.standard_normal(len(t))


def test_a_log_without_slow_motion_tells_sliding_and_no_presliding() -> None:
    look = friction_from_signals(*fast_motion())
    assert look.value("inertia").value == pytest.approx(90.0, rel=0.01)
    assert look.value("Coulomb friction").value == pytest.approx(20.0, rel=0.03)
    assert look.value("viscous friction").value == pytest.approx(200.0, rel=0.01)
    for name in ("break-away friction", "presliding stiffness"):
        assert not look.value(name).excited
        assert math.isnan(look.value(name).value)
    assert look.value("break-away friction").why == "the machine never starts from rest"


def test_constant_speed_tells_no_inertia_and_does_not_part_friction() -> None:
    t = 1e-3 * np.arange(2000)
    random = np.random.default_rng(0)
    x = 0.1 * t + 1e-7 * random.standard_normal(len(t))
    look = friction_from_signals(t, x, 40.0 + 0.2 * random.standard_normal(len(t)))
    for name in ("inertia", "Coulomb friction", "viscous friction", "offset", "Coulomb friction negative"):
        assert not look.value(name).excited, name


def test_a_torque_and_an_angle_give_an_inertia_of_rotation() -> None:
    def rate(t: float, y: np.ndarray) -> list[float]:
        return [y[1], (torque(t) - 0.05 * math.tanh(y[1] / 1e-3) - 0.01 * y[1]) / 2e-3]

    def torque(t: float) -> float:
        return 0.4 * math.sin(2.0 * math.pi * 3.0 * t)

    t = 1e-3 * np.arange(3000)
    found = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0], t_eval=t, method="Radau", rtol=1e-8, atol=1e-10)
    drive = np.array([torque(at) for at in t])
    look = friction_from_signals(t, found.y[0], drive, unit="N.m", length="rad")
    assert look.value("inertia").unit == "kg.m2"
    assert look.value("inertia").value == pytest.approx(2e-3, rel=0.01)
    assert look.value("Coulomb friction").value == pytest.approx(0.05, rel=0.05)


def test_a_log_in_which_nothing_moves_is_refused() -> None:
    t = 1e-3 * np.arange(1000)
    noise = 1e-8 * np.random.default_rng(0).standard_normal(len(t))
    with pytest.raises(DescriptionError, match="without excitation"):
        friction_from_signals(t, noise, np.sin(t))


def test_a_force_that_never_changes_is_refused() -> None:
    t, x, force = fast_motion()
    with pytest.raises(DescriptionError, match="the force is 0 N in all samples"):
        friction_from_signals(t, x, 0.0 * force)


def test_a_force_with_the_wrong_sign_gives_no_inertia() -> None:
    t, x, force = fast_motion()
    inertia = friction_from_signals(t, x, -force).value("inertia")
    assert not inertia.excited
    assert "must push towards positive position" in inertia.why


def record(folder: Path, head: str, position: float = 1.0, force: float = 1.0) -> Path:
    """A mass of 2 kg with a sine of 20 N against friction of 3 N and 4 N.s/m, in multiples of m and N."""

    def rates(t: float, x: list[float]) -> list[float]:
        return [x[1], (20.0 * math.sin(2.0 * math.pi * t) - 3.0 * math.tanh(x[1] / 1e-4) - 4.0 * x[1]) / 2.0]

    t = np.arange(2000) * 1e-3
    x = solve_ivp(rates, (0.0, 2.0), [0.0, 0.0], t_eval=t, method="Radau", rtol=1e-6, atol=1e-9).y[0]
    u = 20.0 * np.sin(2.0 * math.pi * t)
    rows = (f"{a!r},{b * position!r},{c * force!r}" for a, b, c in zip(t.tolist(), x.tolist(), u.tolist(), strict=True))
    path = folder / "log.csv"
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return path


def test_columns_count_in_their_units(tmp_path: Path) -> None:
    path = record(tmp_path, "t,x [mm],u [kN]", 1e3, 1e-3)
    look = identify_friction(path, position="x", force="u")
    assert (look.unit, look.length, look.notes) == ("kN", "m", ())
    assert look.value("Coulomb friction").value == pytest.approx(3e-3, rel=0.01)
    assert look.value("inertia").value == pytest.approx(2e-3, rel=0.01)
    # 1000 may take kN to N, or be a gain: the unit after it must be said
    with pytest.raises(DescriptionError, match=r"u is in kN: say the unit after the factor, --unit N or"):
        identify_friction(path, position="x", force="u", factor=1e3)
    named = identify_friction(path, position="x", force="u", factor=1e3, force_unit="N")
    assert named.value("inertia").value == pytest.approx(2.0, rel=0.01)


def test_units_that_nothing_says_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["identify", "friction", str(record(tmp_path, "t,x,u")), "--position", "x", "--force", "u"]
    assert main(arguments) == 0
    said = capsys.readouterr().err
    assert "note: nothing says the unit of x: taken as m." in said
    assert "note: nothing says the unit of u: taken as N." in said
    assert main([*arguments, "--unit", "N"]) == 0
    assert "unit of u" not in capsys.readouterr().err


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["identify", "friction", str(EXAMPLES / "stage.csv"), "--force", "command", "--unit", "N"]
    arguments += ["--factor", repr(FACTOR)]
    picture = tmp_path / "friction.png"
    assert main([*arguments, "--json", "--plot", str(picture)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["values"]["presliding stiffness"]["excited"]
    assert picture.stat().st_size > 10_000
    assert main([*arguments, "--window", "1.0", "1.02"]) == 2
    assert "too few" in capsys.readouterr().err
