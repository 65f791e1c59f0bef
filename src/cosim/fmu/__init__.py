"""FMU files: their archive, their model description, and the places where they are found."""
