"""A slave for PythonFMU's exporter: a gain that notes how it is called."""

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real


class Gain(Fmi2Slave):
    """y = k u; u of the first step, the shortest step, the end of the last step."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.k = 1.0
        self.u = 1.0
        self.y = 0.0
        self.first = -1.0
        self.shortest = 1.0
        self.end = 0.0
        fixed = {"variability": Fmi2Variability.fixed, "initial": Fmi2Initial.exact}
        free = {"variability": Fmi2Variability.continuous, "initial": Fmi2Initial.exact}
        self.register_variable(Real("k", causality=Fmi2Causality.parameter, **fixed))
        self.register_variable(Real("u", causality=Fmi2Causality.input, variability=Fmi2Variability.continuous))
        for name in ("y", "first", "shortest", "end"):
            self.register_variable(Real(name, causality=Fmi2Causality.output, **free))

    def do_step(self, current_time, step_size):
        if self.first == -1.0:
            self.first = self.u
        self.y = self.k * self.u
        self.shortest = min(self.shortest, step_size)
        self.end = current_time + step_size
        return True
