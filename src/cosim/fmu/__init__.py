"""What an FMU file is: its archive, its description, where FMUs are found."""
