"""Controller ``FrictionFeedforward``: adds the friction that a model expects to the force of any controller."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Controller, Experiment, Note, Record, parameter, sign, variable, where
from fmus.physics.lugre import friction, friction_level, observer_step, rising_note


class FrictionFeedforward(Controller):
    """Friction of the reference motion, added to the force of a controller that has no friction model of its own.

    At sample k, with v the reference velocity; the model is LuGre and is solved by backward Euler:

        G            = F_C_hat + (F_S_hat - F_C_hat)*exp(-(v/v_s_hat)^2)
        z[k]         = (z[k-1] + T_s*v)/(1 + T_s*abs(v)*sigma_0_hat/G),  z[-1] = sign(v)*G/sigma_0_hat
        friction_hat = sigma_0_hat*z[k] + sigma_1_hat*(z[k] - z[k-1])/T_s + sigma_2_hat*v
        command      = force + share*friction_hat

    The component stands between a controller and its plant: positive force and positive friction_hat drive towards
    positive position. The friction model is that of the sliding-mode controllers, in N and m at the table. Its only
    input is the reference, so it cannot make a loop unstable. It has the limits of LuGre friction: while the reference
    rests, the friction of the last motion is kept. Do not give sigma_2_hat to a controller that cancels viscous
    friction itself.

    Source: Canudas de Wit, Olsson, Astrom, Lischinsky, A new model for control of systems with friction, IEEE Trans.
    Automatic Control 40(3), 1995, sec. IV; Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models, analysis
    tools and compensation methods for the control of machines with friction, Automatica 30(7), 1994, sec. 5.2
    (feed-forward of friction from the reference velocity).
    """

    share: float = parameter(1.0, "1", "Share of the friction that is added, 0 for none", min=0.0)
    sigma_0_hat: float = parameter(1.8e7, "N/m", "Stiffness of the bristles", min=1e-9, nominal=1e7)
    sigma_1_hat: float = parameter(0.0, "N.s/m", "Damping of the bristles", min=0.0, nominal=1e4)
    sigma_2_hat: float = parameter(0.0, "N.s/m", "Viscous friction", min=0.0, nominal=100.0)
    F_C_hat: float = parameter(90.0, "N", "Coulomb friction", min=1e-12, nominal=100.0)
    F_S_hat: float = parameter(115.0, "N", "Static friction", min=1e-12, nominal=100.0)
    v_s_hat: float = parameter(2e-3, "m/s", "Stribeck speed", min=1e-12, nominal=1e-3)

    experiment: ClassVar[Experiment] = Experiment(stop_time=10.0, step_size=1e-4)

    class State(Record):
        started: float = variable(0.0, "1", "1 after the first sample")
        bristle: float = variable(0.0, "m", "Deflection in the friction model", nominal=1e-6, display_unit="um")

    class Input(Record):
        force: float = variable(0.0, "N", "Force of the controller", nominal=100.0)
        velocity_ref: float = variable(0.0, "m/s", "Reference velocity", nominal=1e-3, display_unit="mm/s")

    class Output(Record):
        command: float = variable(0.0, "N", "Force with the friction of the model", nominal=100.0)
        friction_hat: float = variable(0.0, "N", "Friction of the model at the reference velocity", nominal=100.0)

    def notes(self, x: State) -> tuple[Note, ...]:
        return (rising_note(self.F_C_hat, self.F_S_hat, "N", "F_C_hat", "F_S_hat"),)

    def bristles(self, x: State, u: Input) -> tuple[float, float]:
        """Deflection in the friction model at the previous sample and at this sample [m]."""
        level = friction_level(u.velocity_ref, self.F_C_hat, self.F_S_hat, self.v_s_hat)
        last = where(x.started > 0.5, x.bristle, sign(u.velocity_ref) * level / self.sigma_0_hat)
        return last, observer_step(last, u.velocity_ref, level, self.sigma_0_hat, self.T_s)

    def output(self, t: float, x: State, u: Input) -> Output:
        last, z = self.bristles(x, u)
        friction_hat = friction(
            z,
            (z - last) / self.T_s,
            u.velocity_ref,
            sigma_0=self.sigma_0_hat,
            sigma_1=self.sigma_1_hat,
            sigma_2=self.sigma_2_hat,
        )
        return self.Output(command=u.force + self.share * friction_hat, friction_hat=friction_hat)

    def update(self, t: float, x: State, u: Input, y: Output) -> State:
        return self.State(started=1.0, bristle=self.bristles(x, u)[1])
