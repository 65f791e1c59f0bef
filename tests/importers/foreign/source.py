"""A slave for PythonFMU's exporter: a constant that is there from the start."""

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real


class Source(Fmi2Slave):
    """y = 5."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y = 5.0
        self.register_variable(
            Real("y", causality=Fmi2Causality.output, variability=Fmi2Variability.continuous, initial=Fmi2Initial.exact)
        )

    def do_step(self, current_time, step_size):
        return True
