"""A slave for PythonFMU's exporter: an Integer parameter and an Integer output."""

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Integer, Real


class Chooser(Fmi2Slave):
    """chosen = mode, as Real and as Integer."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.mode = 1
        self.chosen = 0.0
        self.count = 0
        fixed = {"variability": Fmi2Variability.fixed, "initial": Fmi2Initial.exact}
        self.register_variable(Integer("mode", causality=Fmi2Causality.parameter, **fixed))
        self.register_variable(
            Real(
                "chosen",
                causality=Fmi2Causality.output,
                variability=Fmi2Variability.continuous,
                initial=Fmi2Initial.exact,
            )
        )
        self.register_variable(
            Integer(
                "count",
                causality=Fmi2Causality.output,
                variability=Fmi2Variability.discrete,
                initial=Fmi2Initial.exact,
            )
        )

    def do_step(self, current_time, step_size):
        self.chosen = float(self.mode)
        self.count += 1
        return True
