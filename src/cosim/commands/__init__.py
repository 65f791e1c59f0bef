"""Everything a terminal sees."""
