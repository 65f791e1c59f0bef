"""The Python flavour: an FMU that runs a component's own Python methods, by PythonFMU."""
